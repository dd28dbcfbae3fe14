# SPDX-License-Identifier: Apache-2.0
"""Reads that are whole or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica.ingest.containers.chunked import EndOfFileError, ExactReader


def test_a_read_gives_everything_or_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"0123456789")
    stream = ExactReader(tmp_path / "a")
    assert stream.read(4) == b"0123"
    assert stream.remaining == 6
    for size in (7, 2**62):
        with pytest.raises(EndOfFileError):
            stream.read(size)
    with pytest.raises(EndOfFileError):
        stream.view(7)
    assert stream.view(6) == b"456789"
    assert stream.remaining == 0
    assert stream.seek(8) == stream.tell() == 8
    assert stream.read(2) == b"89"
    stream.close()
