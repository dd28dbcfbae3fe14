# SPDX-License-Identifier: Apache-2.0
"""Files are whole or not there."""

from __future__ import annotations

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
