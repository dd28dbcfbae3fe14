# SPDX-License-Identifier: Apache-2.0
"""Hashes that tell whether two sources hold the same bytes."""

import hashlib
import os
from collections.abc import Sequence

from multilica.ingest.remote.remote_file import RemoteFile, SourceFile

WHOLE_FILE_BYTES = 256 << 20
"""Larger files are hashed by size, beginning and end only."""
_EDGE_BYTES = 64 << 20
_BLOCK_BYTES = 1 << 20


def sha256_of_files(files: Sequence[SourceFile]) -> str:
    """Return the SHA-256 in hexadecimal.

    One file: as `sha256sum`. Several files: the hash of the lines ``<hash>  <name>`` of `sha256sum`, sorted by path.
    For files above 256 MiB, the hash is that of the size in ASCII digits and the first and last 64 MiB, so that a log
    of 30 GB takes no longer than the data that is read of it; for remote files above 2 MiB, the first and last 1 MiB,
    where an MCAP file has its index.
    """
    if len(files) == 1:
        return _sha256_of_file(files[0])
    lines = [f"{_sha256_of_file(path)}  {path.name}\n" for path in sorted(files, key=str)]
    return hashlib.sha256(os.fsencode("".join(lines))).hexdigest()


def _sha256_of_file(path: SourceFile) -> str:
    digest = hashlib.sha256()
    size = path.stat().st_size
    parts = [(0, size)]
    is_remote = isinstance(path, RemoteFile)
    edge_bytes = 1 << 20 if is_remote else _EDGE_BYTES
    if size > (2 * edge_bytes if is_remote else WHOLE_FILE_BYTES):
        digest.update(str(size).encode())
        parts = [(0, edge_bytes), (size - edge_bytes, edge_bytes)]
    with path.open("rb") as file:
        for start, length in parts:
            file.seek(start)
            for offset in range(0, length, _BLOCK_BYTES):
                digest.update(file.read(min(_BLOCK_BYTES, length - offset)))
    return digest.hexdigest()
