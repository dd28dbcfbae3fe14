# SPDX-License-Identifier: Apache-2.0
"""Files are whole or not there."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from multilica.sinks.files.atomic import atomic_file, begun_files, partial_path, write_text_atomically


def test_the_file_appears_only_when_the_block_ends(tmp_path):
    path = tmp_path / "out.bin"
    with atomic_file(path) as file:
        file.write(b"half")
        assert not path.exists()
    assert path.read_bytes() == b"half"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.bin"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "out.txt"
    write_text_atomically(path, "old")

    def write_half() -> None:
        with atomic_file(path) as file:
            file.write(b"new, but")
            raise error

    with pytest.raises(error):
        write_half()
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.txt"]


@pytest.mark.parametrize(
    "number", [errno.ENOSPC, errno.EACCES], ids=["of a write, without a name", "of the begun file"]
)
def test_an_error_of_the_system_names_the_file(tmp_path, number):
    path = tmp_path / "out.txt"

    def fail() -> None:
        with atomic_file(path):
            (begun,) = begun_files(path)
            raise OSError(number, "made") if number == errno.ENOSPC else OSError(number, "made", str(begun))

    with pytest.raises(OSError, match="made") as failure:
        fail()
    assert failure.value.filename == str(path)


@pytest.mark.parametrize("name", [".", "folder"])
def test_a_folder_is_no_file_to_write(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError), atomic_file(Path(name)):
        pass
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


def test_the_error_is_told_even_if_the_begun_file_is_gone(tmp_path):
    path = tmp_path / "out.txt"

    def lose_and_fail() -> None:
        with atomic_file(path):
            (begun,) = begun_files(path)
            begun.unlink()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        lose_and_fail()


def test_names_of_begun_and_partial_files(tmp_path):
    path = tmp_path / "run[1].rrd"
    with atomic_file(path) as file:
        (begun,) = begun_files(path)
        assert begun.name.startswith(".run[1].rrd.")
        assert begun_files(tmp_path / "run1.rrd") == []
        file.write(b"")
    assert begun_files(path) == []
    assert partial_path(path) == tmp_path / "run[1].partial.rrd"


@pytest.fixture
def writing(tmp_path):
    """A process that has begun to write out.txt."""
    code = "import sys, time; from pathlib import Path; from multilica.sinks.files.atomic import atomic_file\n"
    code += "with atomic_file(Path(sys.argv[1])): print('begun', flush=True); time.sleep(60)"
    command = [sys.executable, "-c", code, str(tmp_path / "out.txt")]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout.readline() == "begun\n"
        yield process
        process.kill()


def test_what_a_killed_process_began_is_removed(tmp_path, writing):
    writing.send_signal(signal.SIGKILL)
    writing.wait()
    (tmp_path / ".other.txt.1.tmp").touch()
    write_text_atomically(tmp_path / "out.txt", "new")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [".other.txt.1.tmp", "out.txt"]


@pytest.mark.usefixtures("writing")
def test_what_another_process_writes_is_left_alone(tmp_path):
    (begun,) = tmp_path.iterdir()
    write_text_atomically(tmp_path / "out.txt", "new")
    assert sorted(tmp_path.iterdir()) == sorted([begun, tmp_path / "out.txt"])


def test_a_writer_leaves_what_another_has_just_finished(tmp_path, monkeypatch):
    path = tmp_path / "out.txt"
    replace = Path.replace

    def another_writes_first(temporary: Path, target: Path) -> Path:
        monkeypatch.setattr(Path, "replace", replace)
        with ThreadPoolExecutor(1) as pool:
            pool.submit(write_text_atomically, path, "other").result()
        return replace(temporary, target)

    monkeypatch.setattr(Path, "replace", another_writes_first)
    write_text_atomically(path, "own")
    assert path.read_text() == "own"
