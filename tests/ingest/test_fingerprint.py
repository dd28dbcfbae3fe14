# SPDX-License-Identifier: Apache-2.0
"""The hash of the input."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from multilica.ingest import fingerprint, read_snapshot
from multilica.ingest.fingerprint import sha256_of_files
from tests.ingest.support.recording_writers import make_snapshot, write_mcap


def test_one_file_is_hashed_as_sha256sum_does(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    expected = hashlib.sha256((tmp_path / "a.mcap").read_bytes()).hexdigest()
    assert read_snapshot(tmp_path / "a.mcap").source_sha256 == expected


def test_several_files_are_hashed_with_their_names_in_any_order(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("b", "a", "c")]
    for path in paths:
        path.write_text(path.name)
    lines = "".join(f"{hashlib.sha256(name.encode()).hexdigest()}  {name}\n" for name in "abc")
    assert sha256_of_files(paths) == sha256_of_files(paths[::-1]) == hashlib.sha256(lines.encode()).hexdigest()


def test_large_files_are_hashed_by_size_and_both_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fingerprint, "WHOLE_FILE_BYTES", 100)
    monkeypatch.setattr(fingerprint, "_EDGE_BYTES", 10)
    content = bytearray(range(200))
    path = tmp_path / "a"

    def digest() -> str:
        path.write_bytes(content)
        return sha256_of_files([path])

    first = digest()
    assert first == hashlib.sha256(b"200" + content[:10] + content[-10:]).hexdigest()
    content[100] ^= 1
    assert digest() == first
    content[195] ^= 1
    assert digest() != first
    content.append(0)
    assert digest() != first
