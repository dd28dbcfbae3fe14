# SPDX-License-Identifier: Apache-2.0
"""The hash that tells whether two runs read the same input."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

__all__ = ["WHOLE_FILE_BYTES", "sha256_of_files"]

WHOLE_FILE_BYTES = 256 << 20
"""Larger files are hashed by their size, their beginning and their end."""
_EDGE_BYTES = 64 << 20
_BLOCK_BYTES = 1 << 20


def sha256_of_files(files: Sequence[Path]) -> str:
    """SHA-256, hexadecimal.

    Of one file: what `sha256sum` prints. Of several: the hash over the lines ``<hash>  <name>`` that `sha256sum` would
    print for them, sorted by path. A file of more than 256 MiB counts as its size in ASCII digits, its first and its
    last 64 MiB, so that a log of 30 GB takes no longer than what is read of it.
    """
    if len(files) == 1:
        return _sha256_of_file(files[0])
    lines = [f"{_sha256_of_file(path)}  {path.name}\n" for path in sorted(files)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _sha256_of_file(path: Path) -> str:
    digest = hashlib.sha256()
    size = path.stat().st_size
    parts = [(0, size)]
    if size > WHOLE_FILE_BYTES:
        digest.update(str(size).encode())
        parts = [(0, _EDGE_BYTES), (size - _EDGE_BYTES, _EDGE_BYTES)]
    with path.open("rb") as file:
        for start, length in parts:
            file.seek(start)
            for offset in range(0, length, _BLOCK_BYTES):
                digest.update(file.read(min(_BLOCK_BYTES, length - offset)))
    return digest.hexdigest()
