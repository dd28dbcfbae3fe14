# SPDX-License-Identifier: Apache-2.0
"""A store on a disk that is full, read-only or refuses: one sentence, no log is marked, and the next run goes on."""

import shutil
import subprocess

import pytest

from multilica.fleet.store.store import open_store
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence


@pytest.fixture
def log(snapshots, tmp_path):
    """A log with one frame of two LiDARs."""
    (tmp_path / "v1").mkdir()
    shutil.copy(snapshots / "first.mcap", tmp_path / "v1" / "log.mcap")


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.usefixtures("log")
def test_a_run_ends_at_a_store_that_refuses_and_goes_on(invoke: Invoke, tmp_path):
    open_store(tmp_path / "store", create=True)
    (tmp_path / "store" / "digests").touch()
    outcome = invoke("fleet", "run", "v1", "--out", "store", "--workers", "1", "-q")
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "The store cannot be used to" in outcome.err
    assert [path.name for path in (tmp_path / "store").iterdir() if path.is_dir()] == []
    (tmp_path / "store" / "digests").unlink()
    outcome = invoke("fleet", "run", "v1", "--out", "store", "--workers", "1")
    assert outcome.out == "1 logs, 0 of them finished before: 1 calibrated.\n"


@pytest.fixture
def disk(tmp_path):
    """Mount and change a disk of some MB; needs the rights of root."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options):
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("this process may not mount a disk")

    mount("size=3m")
    yield place, mount
    subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.usefixtures("log")
@pytest.mark.parametrize("limit", ["size=3m", pytest.param("ro", marks=pytest.mark.nightly)])
def test_a_full_or_read_only_disk_ends_the_run(limit, disk, invoke: Invoke):
    place, mount = disk
    store = open_store(place / "store", create=True)
    if limit == "ro":
        mount("remount,ro")
    else:
        (place / "filled").write_bytes(bytes(2_900_000))
    outcome = invoke("fleet", "run", "v1", "--out", store.root, "--workers", "1", "-q")
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert ("Read-only file system" if limit == "ro" else "No space left on device") in outcome.err
    assert list(store.parts("logs")) == []
    mount("remount,rw,size=200m")
    outcome = invoke("fleet", "run", "v1", "--out", store.root, "--workers", "1")
    assert outcome.out == "1 logs, 0 of them finished before: 1 calibrated.\n"
