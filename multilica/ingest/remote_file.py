# SPDX-License-Identifier: Apache-2.0
"""A file on a server, with the part of `pathlib.Path` that readers use."""

from __future__ import annotations

import os
import stat
import time
import weakref
from contextlib import closing
from functools import cached_property
from pathlib import Path, PurePosixPath
from shutil import copyfileobj, rmtree
from tempfile import mkdtemp
from threading import Lock
from typing import IO, Any, TypeAlias, cast
from urllib.parse import urlsplit

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.ingest.address import scheme_of, without_secrets
from multilica.ingest.block_cache import BLOCK_BYTES, BlockCache, BlockStream
from multilica.ingest.remote_failures import ConnectionLostError, WithoutRangesError, remote_failures_named
from multilica.ingest.remote_system import open_system

__all__ = ["MAX_WHOLE_BYTES", "RemoteFile", "SourceFile"]

MAX_WHOLE_BYTES = 2 << 30
"""Larger files are read by ranges or not at all."""

_WEB = ("https", "http")
_PIECE_BYTES = 8 << 20
_RETRY_AFTER_S = (0.5, 2.0)


class RemoteFile:
    """A file that is read by byte ranges; nothing is asked of the server before it is needed.

    From a web server that serves whole files only, it is fetched whole.

    Args:
        url: ``s3://``, ``gs://``, ``https://`` or ``http://``; only its part without secrets is ever shown.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._scheme = scheme_of(url)
        self._path = PurePosixPath(urlsplit(url).path)
        self._lock = Lock()
        self._copied: Path | None = None

    def __str__(self) -> str:
        return without_secrets(self._url)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemoteFile) and other._url == self._url

    def __hash__(self) -> int:
        return hash(self._url)

    @property
    def name(self) -> str:
        """Last part of the path."""
        return self._path.name

    @property
    def stem(self) -> str:
        """The name without its suffix."""
        return self._path.stem

    @property
    def suffix(self) -> str:
        """What the name ends in, from its last dot on."""
        return self._path.suffix

    @property
    def parent(self) -> PurePosixPath:
        """The path on the server without the name."""
        return self._path.parent

    def resolve(self) -> RemoteFile:
        """Itself."""
        return self

    def exists(self) -> bool:
        """Whether the server has it."""
        try:
            return self._cache.size >= 0
        except SourceNotFoundError:
            return False

    def is_file(self) -> bool:
        """Always: what is no file does not exist here."""
        return True

    def is_dir(self) -> bool:
        """Never."""
        return False

    def stat(self) -> os.stat_result:
        """Mode and size; all else is zero."""
        return os.stat_result((stat.S_IFREG | 0o444, 0, 0, 0, 0, 0, self._cache.size, 0, 0, 0))

    def open(self, mode: str = "rb") -> IO[bytes]:
        """A stream; all streams of this object share the blocks that were fetched."""
        if mode != "rb":
            raise ValueError(f"expected mode 'rb', found '{mode}'")
        return cast(IO[bytes], BlockStream(self._cache))

    def read_bytes(self) -> bytes:
        """The whole file.

        Raises:
            UnreadableSourceError: it is larger than `MAX_WHOLE_BYTES`.
        """
        self.require_size("a file of this format")
        return self._fetch(0, self._cache.size)

    def copy(self, what: str) -> Path:
        """A copy on disk under the same name, fetched once; it goes when nobody holds this object any more.

        Args:
            what: what the file is, for the message.

        Raises:
            UnreadableSourceError: it is larger than `MAX_WHOLE_BYTES`.
        """
        if self._copied is None:
            self.require_size(what)
            path = self._place_on_disk()
            with self.open() as source, path.open("wb") as target:
                copyfileobj(source, target, _PIECE_BYTES)
            self._copied = path
        return self._copied

    def require_size(self, what: str) -> None:
        """Check that the file may be fetched whole.

        Args:
            what: what it is, for the message.

        Raises:
            UnreadableSourceError: it is larger than `MAX_WHOLE_BYTES`.
        """
        if self._cache.size > MAX_WHOLE_BYTES:
            raise UnreadableSourceError(
                f"{self} has {self._cache.size / 1e9:.1f} GB, and {what} can only be read as a whole, which is done "
                f"up to {MAX_WHOLE_BYTES / 1e9:.1f} GB; download it, or give an indexed MCAP file."
            )

    @cached_property
    def _cache(self) -> BlockCache:
        return BlockCache(self._fetch, int(self._handle.size))

    @cached_property
    def _handle(self) -> Any:  # noqa: ANN401 - fsspec has no types
        with remote_failures_named(str(self), self._scheme):
            system, path = open_system(self._url)
            handle = system.open(path, "rb", block_size=BLOCK_BYTES, cache_type="none")
            is_folder = handle.details.get("type") == "directory"
        if is_folder:
            raise UnreadableSourceError(f"{self} is a folder; expected the address of a file.")
        if handle.size is None or not handle.seekable() or not self._serves_ranges(handle):
            handle.close()
            return self._whole(system, path, handle.size)
        return handle

    def _serves_ranges(self, handle: Any) -> bool:  # noqa: ANN401 - see _handle
        """Whether the last byte can be had alone; a web server need not say."""
        if self._scheme not in _WEB or handle.size <= BLOCK_BYTES:
            return True
        try:
            with remote_failures_named(str(self), self._scheme):
                handle.seek(handle.size - 1)
                return bool(handle.read(1))
        except WithoutRangesError:
            return False

    def _whole(self, system: Any, path: str, told_bytes: int | None) -> Any:  # noqa: ANN401 - see _handle
        """The file on disk, fetched from front to end."""
        import fsspec

        self._require_whole_size(told_bytes or 0)
        size, on_disk = 0, self._place_on_disk()
        with remote_failures_named(str(self), self._scheme):
            source = system.open(path, "rb", block_size=0)
        with closing(source), on_disk.open("wb") as target:
            while data := self._next_piece(source):
                size += target.write(data)
                self._require_whole_size(size)
        self._copied = on_disk
        return fsspec.filesystem("file").open(on_disk, "rb")

    def _next_piece(self, source: Any) -> bytes:  # noqa: ANN401 - see _handle
        with remote_failures_named(str(self), self._scheme):
            return bytes(source.read(_PIECE_BYTES))

    def _require_whole_size(self, size: int) -> None:
        if size > MAX_WHOLE_BYTES:
            raise UnreadableSourceError(
                f"{self} has more than {MAX_WHOLE_BYTES / 1e9:.1f} GB, and its server serves no parts of files; "
                "download it."
            )

    def _place_on_disk(self) -> Path:
        """In a folder that goes when nobody holds this object any more."""
        folder = Path(mkdtemp(prefix="multilica-"))
        weakref.finalize(self, rmtree, folder, ignore_errors=True)
        return folder / (self.name or "download")

    def _fetch(self, start: int, end: int) -> bytes:
        for pause_s in _RETRY_AFTER_S:
            try:
                return self._fetch_once(start, end)
            except ConnectionLostError:
                time.sleep(pause_s)
        return self._fetch_once(start, end)

    def _fetch_once(self, start: int, end: int) -> bytes:
        with remote_failures_named(str(self), self._scheme), self._lock:
            self._handle.seek(start)
            data = bytes(self._handle.read(end - start))
        if len(data) != end - start:
            raise ConnectionLostError(f"The server of {self} sent {len(data)} of {end - start} bytes; try again.")
        return data


SourceFile: TypeAlias = Path | RemoteFile
"""What the readers read."""
