# SPDX-License-Identifier: Apache-2.0
"""A file on a server, with the part of `pathlib.Path` that readers use, and its errors as one sentence.

`UPath` does not fit: for a signed address, its `name`, `suffix` and text contain the signature.
"""

from __future__ import annotations

import logging
import os
import stat
import time
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cached_property
from http import HTTPStatus
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any, Literal, TypeAlias, cast
from urllib.parse import urlsplit

from multilica.errors import MultilicaError, SourceNotFoundError, UnreadableSourceError
from multilica.ingest.remote.address import scheme_of, without_secrets
from multilica.optional_libraries import raise_missing
from multilica.scratch import scratch_folder

if TYPE_CHECKING:
    from multilica.ingest.remote.file_cache import FileCache

MAX_WHOLE_BYTES = 2 << 30
"""Limit of files that are downloaded as a whole."""

_PIECE_BYTES = 8 << 20
_RETRY_AFTER_S = (0.5, 2.0)
_CONNECT_S = 10
_READ_S = 30
_SLOWEST_BYTES_PER_S = 50_000
"""A read ends after `_READ_S` and the time that its bytes take at this speed, however steadily a server drips them."""

_CREDENTIALS = {
    "s3": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or AWS_PROFILE, or FSSPEC_S3_ANON=true for a public bucket",
    "gs": "run `gcloud auth application-default login`, or set FSSPEC_GS_TOKEN=anon for a public bucket",
}
_NO_CREDENTIALS = {
    "CredentialRetrievalError",
    "DefaultCredentialsError",
    "NoCredentialsError",
    "PartialCredentialsError",
    "ProfileNotFound",
    "RefreshError",
}
_LATE = {"FSTimeoutError", "TimeoutError", "ConnectTimeoutError", "ReadTimeoutError"}
_LOST = {"ClientConnectionError", "ClientPayloadError", "ConnectionError", "HTTPClientError", "IncompleteReadError"}
_NO_HTTP = {"HttpProcessingError", "BadHttpMessage", "ContentEncodingError"}
_BAD_REDIRECTS = {"InvalidURL", "InvalidUrlClientError", "RedirectClientError"}


class RemoteFile:
    """A file that is read by byte ranges, or a folder of a bucket, with no request before the first access.

    If a web server does not support ranges, the whole file is downloaded.

    Args:
        url: ``s3://``, ``gs://``, ``https://`` or ``http://``; only the part without secrets is ever shown. A folder
            ends in ``/``.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._scheme = scheme_of(url)
        path = PurePosixPath(urlsplit(url).path)
        self.name, self.stem, self.parent = path.name, path.stem, path.parent
        self._handle: Any = None

    def __str__(self) -> str:
        return without_secrets(self._url)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemoteFile) and other._url == self._url

    def __hash__(self) -> int:
        return hash(self._url)

    def resolve(self) -> RemoteFile:
        """Return itself."""
        return self

    def exists(self) -> bool:
        """Return whether the server has it."""
        with suppress(SourceNotFoundError):
            return any(True for _ in self.iterdir()) if self.is_dir() else bool(self._cache.size >= 0)
        return False

    def is_file(self) -> bool:
        """Return whether it is no folder."""
        return not self.is_dir()

    def is_dir(self) -> bool:
        """Return whether it is a folder of a bucket, by its address."""
        return not self._is_web and self._url.endswith("/")

    def __truediv__(self, name: str) -> RemoteFile:
        return RemoteFile(f"{self._url}{name}")

    def iterdir(self) -> Iterator[RemoteFile]:
        """Yield files and folders in a folder; raise SourceNotFoundError if there are none."""
        with remote_failures_named(str(self), self._scheme):
            system, path = open_file_system(self._url)
            entries = system.ls(path.rstrip("/"), detail=True)
        for entry in entries:
            name = entry["name"].rstrip("/").rpartition("/")[2]
            if entry["name"].strip("/") != path.strip("/"):  # some tools make an object for the folder itself
                yield self / (f"{name}/" if entry["type"] == "directory" else name)

    def stat(self) -> os.stat_result:
        """Return mode and size in bytes; all else is zero."""
        return os.stat_result((stat.S_IFREG | 0o444, 0, 0, 0, 0, 0, self._cache.size, 0, 0, 0))

    def open(self, _mode: Literal["rb"] = "rb", buffering: int = -1) -> IO[bytes]:
        """Open a stream; all streams of this object share a cache, whatever the `buffering`."""
        del buffering
        from multilica.ingest.remote.file_cache import CachedStream

        return cast(IO[bytes], CachedStream(self._cache))

    def copy(self, what: str) -> Path:
        """Download the file to a copy that is removed together with this object.

        Raises:
            UnreadableSourceError: it is larger than `MAX_WHOLE_BYTES`.
        """
        advice = "download it, or give an indexed MCAP file"
        self._require_size(self._cache.size, f"{what} can only be read as a whole", advice)
        for start in range(0, self._cache.size, _PIECE_BYTES):
            self._cache.read(start, start + _PIECE_BYTES)
        return Path(self._cache.location)

    def _require_size(self, size: int, why: str, what_to_do: str = "download it") -> None:
        if size > MAX_WHOLE_BYTES:
            raise UnreadableSourceError(
                f"{self} has more than {MAX_WHOLE_BYTES / 1e9:.1f} GB, and {why}; {what_to_do}."
            )

    @cached_property
    def _cache(self) -> FileCache:
        with remote_failures_named(str(self), self._scheme):
            from multilica.ingest.remote.file_cache import BLOCK_BYTES, FileCache

            system, path = open_file_system(self._url)
            options = {}
            if self._is_web:
                # Opening asks for the size as well, but without a time limit.
                found = system.info(path, timeout=_READ_S)
                options = {"size": found["size"]} if found.get("size") and found.get("partial", True) else {}
            handle = system.open(path, "rb", block_size=BLOCK_BYTES, cache_type="none", **options)
            if handle.details.get("type") == "directory":
                raise UnreadableSourceError(
                    f"{self} is a folder; expected the address of a file, or {self}/ for a bag in a bucket."
                )
            stack = ExitStack()
            on_disk = stack.enter_context(scratch_folder()) / (self.name or "download")
            weakref.finalize(self, stack.close)
            if handle.size is None or not handle.seekable() or not self._serves_ranges(handle):
                handle.close()
                size = self._download(system, path, handle.size, on_disk)
                return FileCache(self._fetch, size, on_disk, range(size // BLOCK_BYTES + 1))
            self._handle = handle
            return FileCache(self._fetch, int(handle.size), on_disk)

    @property
    def _is_web(self) -> bool:
        return self._scheme in ("https", "http")

    def _serves_ranges(self, handle: Any) -> bool:  # noqa: ANN401 - fsspec has no types
        """Return whether the last byte can be read alone; a web server need not announce it."""
        if not self._is_web or handle.size <= handle.blocksize:
            return True
        try:
            with remote_failures_named(str(self), self._scheme):
                return bool(self._read_range(handle, handle.size - 1, handle.size))
        except WithoutRangesError:
            return False

    def _download(self, system: Any, path: str, stated_bytes: int | None, target: Path) -> int:  # noqa: ANN401
        """Download the file from front to end and return its size in bytes."""
        why = "its server does not serve parts of files"
        self._require_size(stated_bytes or 0, why)
        size = 0
        with remote_failures_named(str(self), self._scheme):
            source = system.open(path, "rb", block_size=0)
            start_s = time.monotonic()
            with closing(source), target.open("wb") as file:
                while data := bytes(source.read(_PIECE_BYTES)):
                    size += file.write(data)
                    self._require_size(size, why)
                    taken_s = time.monotonic() - start_s
                    if taken_s > _READ_S + size / _SLOWEST_BYTES_PER_S:
                        raise UnreadableSourceError(
                            f"The server of {self} sent only {size} bytes in {taken_s:.0f} s; try again later."
                        )
        return size

    def _fetch(self, start: int, end: int) -> bytes:
        begin_s = time.monotonic()
        for pause_s in _RETRY_AFTER_S:
            try:
                return self._fetch_once(start, end)
            except ConnectionLostError:
                if time.monotonic() - begin_s >= _READ_S:
                    raise
                time.sleep(pause_s)
        return self._fetch_once(start, end)

    def _read_range(self, handle: Any, start: int, end: int) -> bytes:  # noqa: ANN401 - see _serves_ranges
        """Read a range of bytes; of a web server within a time limit for all of them."""
        if self._is_web:
            limit_s = _READ_S + (end - start) / _SLOWEST_BYTES_PER_S
            from fsspec.asyn import sync

            return cast(bytes, sync(handle.loop, _fetch_range, handle, start, end, timeout=limit_s))
        handle.seek(start)
        return bytes(handle.read(end - start))

    def _fetch_once(self, start: int, end: int) -> bytes:
        with remote_failures_named(str(self), self._scheme):
            data = self._read_range(self._handle, start, end)
        if len(data) != end - start:
            raise ConnectionLostError(f"The server of {self} sent {len(data)} of {end - start} bytes; try again.")
        return data


async def _fetch_range(handle: Any, start: int, end: int) -> bytes:  # noqa: ANN401 - see _serves_ranges
    """Read a range of bytes from a web server, and never more than asked for."""
    options = dict(handle.kwargs)
    headers = {**options.pop("headers", {}), "Range": f"bytes={start}-{end - 1}"}
    data = bytearray()
    async with handle.session.get(handle.fs.encode_url(handle.url), headers=headers, **options) as response:
        if response.status == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            return b""
        response.raise_for_status()
        given = response.headers.get("Content-Range", "").replace("=", " ").split("-")[0]
        if start > 0 and response.status != HTTPStatus.PARTIAL_CONTENT and given != f"bytes {start}":
            raise ValueError("no range requests")
        async for block in response.content.iter_chunked(1 << 20):
            data += block
            if len(data) > end - start:
                break
    return bytes(data[: end - start])


SourceFile: TypeAlias = Path | RemoteFile
"""A file or folder that readers read."""


def path_on_disk(file: SourceFile, what: str) -> Path:
    """Return the path of a file, or of a local copy of a remote one; errors as in `RemoteFile.copy`."""
    return file.copy(what) if isinstance(file, RemoteFile) else file


def open_file_system(url: str) -> tuple[Any, str]:
    """Return the file system of an address and the path in it."""
    if scheme_of(url) == "gs":
        # The default of fsspec asks for the kind of the bucket over gRPC, and waits forever if nobody answers.
        import gcsfs.core

        # Without a handler, the errors that it logs before raising would appear on the terminal.
        logging.getLogger("gcsfs").addHandler(logging.NullHandler())
        system = gcsfs.core.GCSFileSystem(**_options(url), skip_instance_cache=True)
        return system, system._strip_protocol(url)  # noqa: SLF001 - as fsspec does it
    import fsspec

    opened: tuple[Any, str] = fsspec.url_to_fs(url, **_options(url), skip_instance_cache=True)
    return opened


def _options(url: str) -> dict[str, Any]:
    """Return the options of a file system, most of all time limits: the defaults wait forever for a silent server."""
    scheme = scheme_of(url)
    if scheme == "s3":
        return {"config_kwargs": {"connect_timeout": _CONNECT_S, "read_timeout": _READ_S}}
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(total=600, sock_connect=_CONNECT_S, sock_read=_READ_S)
    if scheme == "gs":
        return {"requests_timeout": timeout}
    # Ranges of a response that is compressed are not ranges of the file.
    client = {"timeout": timeout, "headers": {"Accept-Encoding": "identity"}}
    # The signature of an address covers its exact text.
    return {"client_kwargs": client, "encoded": "%" in url}


class ConnectionLostError(UnreadableSourceError):
    """A server does not answer; trying again may help."""


class WithoutRangesError(UnreadableSourceError):
    """A server does not serve parts of files."""


@contextmanager
def remote_failures_named(where: str, scheme: str) -> Iterator[None]:
    """Turn any error of a client library into one sentence, without its text, which may contain a key."""
    try:
        yield
    except MultilicaError:
        raise
    except ImportError as error:
        raise_missing(f"Reading {where}", {"s3": "s3fs", "gs": "gcsfs"}.get(scheme, "fsspec"), error)
    except Exception as error:
        raise _explained(error, where, scheme) from error


def _explained(error: Exception, where: str, scheme: str) -> MultilicaError:  # noqa: C901, PLR0911 - one per reason
    causes = list(_causes(error))
    # By name, so that no client library is imported to recognise its exceptions.
    names = {kind.__name__ for cause in causes for kind in type(cause).__mro__}
    # A body that ends early has the status of bad HTTP.
    status = None if "ClientPayloadError" in names else _status(causes, names)
    hint = _CREDENTIALS.get(scheme, "check that the address is complete and still valid")
    if "TooManyRedirects" in names:
        return UnreadableSourceError(f"The server of {where} redirects without end; check the address.")
    if names & _BAD_REDIRECTS:
        return UnreadableSourceError(f"The server of {where} redirects to an address that is not valid.")
    if names & _NO_HTTP and not names & _LOST:
        return UnreadableSourceError(f"The server of {where} does not answer in valid HTTP; download the file.")
    if names & _NO_CREDENTIALS:
        return UnreadableSourceError(f"No credentials were found for {where}; {hint}.")
    if status in (401, 403):
        return UnreadableSourceError(f"Access to {where} is denied; {hint}.")
    if status in (404, 410):
        return SourceNotFoundError(f"Nothing exists at {where}.")
    if status is not None:
        return UnreadableSourceError(f"The server of {where} answers with status {status}; try again later.")
    if names & _LATE:
        return ConnectionLostError(f"The server of {where} did not answer in time; try again, or download the file.")
    if names & _LOST:
        return ConnectionLostError(f"The connection to the server of {where} failed; check the address, try again.")
    if any("range requests" in str(cause) for cause in causes):
        return WithoutRangesError(f"The server of {where} does not serve parts of files; download the file.")
    return UnreadableSourceError(f"{where} cannot be read ({type(error).__name__}); try to download the file.")


def _status(causes: list[BaseException], names: set[str]) -> int | None:
    """Return the status of HTTP, also if a client library has raised a built-in exception for it."""
    found = (getattr(cause, name, None) for cause in causes for name in ("status", "code"))
    status = next((code for code in found if isinstance(code, int) and code >= 400), None)
    if status is not None or names & (_LATE | _LOST):
        return status
    return 403 if "PermissionError" in names else 404 if "FileNotFoundError" in names else None


def _causes(error: BaseException) -> Iterator[BaseException]:
    seen: BaseException | None = error
    while seen is not None:
        yield seen
        seen = seen.__cause__
