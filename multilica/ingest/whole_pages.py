# SPDX-License-Identifier: Apache-2.0
"""A view of an SQLite file that ends with its last whole page."""

from __future__ import annotations

import apsw

__all__ = ["WHOLE_PAGES", "page_bytes"]

WHOLE_PAGES = "multilica_whole_pages"
"""Name of the view, to be given to a connection as its `vfs`.

SQLite takes a page that was cut through for whole, with zeros where the file ends: zeros that would be points.
"""

_HEADER_BYTES = 18


def page_bytes(header: bytes) -> int:
    """The page size that the beginning of an SQLite file tells; 1 if it tells none."""
    size = int.from_bytes(header[_HEADER_BYTES - 2 : _HEADER_BYTES], "big")
    # In two bytes, 65536 is written as 1.
    return 65536 if size == 1 else max(size, 1)


class _WholePages(apsw.VFS):
    def xOpen(self, name: str | apsw.URIFilename | None, flags: list[int]) -> apsw.VFSFile:  # noqa: N802
        """Called by SQLite."""
        return _WholePagesFile("", name, flags)


class _WholePagesFile(apsw.VFSFile):
    def xFileSize(self) -> int:  # noqa: N802
        """Called by SQLite."""
        size = super().xFileSize()
        return size - size % page_bytes(super().xRead(_HEADER_BYTES, 0)) if size >= _HEADER_BYTES else 0


_REGISTERED = _WholePages(WHOLE_PAGES, "")
