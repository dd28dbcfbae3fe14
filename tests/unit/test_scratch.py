# SPDX-License-Identifier: Apache-2.0
"""Working files of killed processes do not pile up."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from multilica.scratch import scratch_folder

ROOT = Path(__file__).parents[2]
KILLED = """
import os, signal, tempfile
from multilica.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "nested").mkdir()
    (folder / "nested" / "file").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_folder_goes_with_its_block(temporary: Path) -> None:
    def write_and_fail() -> None:
        with scratch_folder() as folder:
            assert folder.parent == temporary
            (folder / "file").write_text("content")
            raise KeyError

    with pytest.raises(KeyError):
        write_and_fail()
    assert list(temporary.iterdir()) == []


def test_what_a_killed_process_left_goes_with_the_next(temporary: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(temporary), "PYTHONPATH": str(ROOT)}
    killed = subprocess.run([sys.executable, "-c", KILLED], env=environment, check=False)
    assert killed.returncode == -signal.SIGKILL
    (left,) = temporary.iterdir()
    assert (left / "nested" / "file").exists()
    with scratch_folder() as folder:
        assert list(temporary.iterdir()) == [folder]


def test_folders_in_use_stay(temporary: Path) -> None:
    with scratch_folder() as one, scratch_folder() as other:
        assert {one, other} == {*temporary.iterdir()}


def test_what_is_not_ours_stays(temporary: Path) -> None:
    own = temporary / "multilica-demo"
    own.mkdir()
    with scratch_folder() as folder:
        name = folder.name
    precious = own / "result.json"
    precious.write_text("{}")
    (temporary / f"{name}x").symlink_to(own)
    (temporary / f"{name}y").write_text("a file of that name")
    with scratch_folder():
        assert precious.exists()
        assert len(list(temporary.iterdir())) == 4


def test_a_folder_removed_before_its_lock_is_made_anew(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, made = tempfile.mkdtemp, []

    def make_and_lose(*arguments: str | None, **named: str | None) -> str:
        made.append(make(*arguments, **named))
        if len(made) == 1:
            shutil.rmtree(made[0])
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", make_and_lose)
    with scratch_folder() as folder:
        assert str(folder) == made[1]
        assert list(temporary.iterdir()) == [folder]
