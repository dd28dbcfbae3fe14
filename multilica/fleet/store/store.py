# SPDX-License-Identifier: Apache-2.0
"""The store: Parquet parts and run files in a folder or in a bucket.

::

    STORE/
      fleet.json                                    name and version of this layout
      lidars/vehicle=V/month=2026-03/KEY.parquet    a row per LiDAR of the log KEY
      logs/vehicle=V/month=2026-03/KEY.parquet      a row for the log KEY, written last: with it the log is finished
      runs/V/2026-03/KEY/                           files of a calibration

A part is written under another name and renamed, or put in one request, so that it is whole or not there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq
from pyarrow.fs import FSSpecHandler, LocalFileSystem, PyFileSystem, SubTreeFileSystem

import multilica
from multilica.documents import local_path
from multilica.errors import (
    MultilicaError,
    SourceNotFoundError,
    StorageError,
    UnreadableSourceError,
    UsageError,
    escape_controls,
)
from multilica.fleet.store.records import SCHEMA_VERSION, TABLES, LidarRow, LogRow, month_of, table_of
from multilica.ingest.remote.address import scheme_of, without_secrets
from multilica.ingest.remote.remote_file import ConnectionLostError, open_file_system, remote_failures_named
from multilica.optional_libraries import needed_for
from multilica.sinks.files.atomic import atomic_file

_LAYOUT, _FORMAT = "fleet.json", "multilica fleet store"
_BUCKETS = {"s3": "s3fs", "gs": "gcsfs"}
"""Scheme of a bucket -> library that reads and writes it."""


def is_store(folder: Path) -> bool:
    """Return whether a folder of this machine holds a store."""
    try:
        with (folder / _LAYOUT).open("rb") as file:
            return _FORMAT.encode() in file.read(1000)
    except OSError:
        return False


def folder_name(name: str) -> str:
    """Return a name from a log as the name of a folder, without separators and dots; `unquote` gives it back."""
    return quote(name, safe="").replace(".", "%2E") or "unknown"


def vehicle_name(text: str) -> str:
    """Return a text from a log as the name of a vehicle: printable, of bounded length, never empty."""
    name = " ".join(escape_controls(text).split())
    while len(folder_name(name)) > 200:  # bytes; file systems take 255
        name = name[:-1]
    return name or "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class Store:
    """A store on a disk or in a bucket: address as given, file system (None on a disk), and path in the latter."""

    address: str
    system: Any
    root: str

    def __str__(self) -> str:
        return without_secrets(self.address) if scheme_of(self.address) else self.address

    @property
    def name(self) -> str:
        """The name of the folder, or the address: nothing that only this machine has."""
        return str(self) if self.system else Path(self.root).name

    def finish(self, log: LogRow, lidars: Sequence[LidarRow]) -> None:
        """Write the rows of a log, the row that makes it finished last."""
        self.write_lidars(log, lidars)
        self.write_log(log)

    def write_lidars(self, log: LogRow, lidars: Sequence[LidarRow]) -> None:
        """Write the rows of a log's LiDARs in place of those of earlier tries; they count once the log has its row."""
        if lidars:
            self.write_part(f"lidars/{_part_of(log)}", table_of(lidars, TABLES["lidars"]))
        else:
            self.remove(f"lidars/{_part_of(log)}")

    def write_log(self, log: LogRow) -> None:
        """Write the row that makes a log finished."""
        self.write_part(f"logs/{_part_of(log)}", table_of([log], TABLES["logs"]))

    def first_with(self, sha256: str, vehicle: str, config_sha256: str, source: str) -> str:
        """Return the first log of a vehicle that had these bytes; that is `source` if none had them before.

        A log that gave no poses was none: its task may have been interrupted, or have ended at a limit.
        """
        path = f"digests/{folder_name(vehicle)}/{config_sha256}-{multilica.__version__}/{sha256}"
        with suppress(SourceNotFoundError):
            first = self.read(path).decode()
            if first == source or self._has_log(first):
                return first
        self.write(path, source.encode())
        return source

    def _has_log(self, source: str) -> bool:
        has_poses = pc.field("state").isin(["verified", "calibrated"])
        return bool(self.dataset("logs").count_rows(filter=(pc.field("source") == source) & has_poses))

    def run_folder(self, vehicle: str, time_ns: int | None, key: str) -> str:
        """Return the path of a log's run files, relative to the store."""
        return f"runs/{folder_name(vehicle)}/{month_of(time_ns)}/{key}"

    def exists(self, path: str) -> bool:
        """Return whether a file is there; `path` is relative to the store."""
        with self._named("read", path):
            if self.system is None:
                return Path(self.root, path).exists()
            self.system.invalidate_cache()  # other processes write as well
            return bool(self.system.exists(f"{self.root}/{path}"))

    def read(self, path: str) -> bytes:
        """Return the content of a file; raise SourceNotFoundError if it is not there."""
        try:
            with self._named("read", path):
                if self.system is None:
                    return Path(self.root, path).read_bytes()
                return bytes(self.system.cat_file(f"{self.root}/{path}"))
        except (FileNotFoundError, SourceNotFoundError) as error:
            raise SourceNotFoundError(f"The store {self} has no {path}.") from error

    def write(self, path: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        with self._named("write", path):
            if self.system is None:
                place = Path(self.root, path)
                place.parent.mkdir(parents=True, exist_ok=True)
                with atomic_file(place) as file:
                    file.write(content)
            else:
                self.system.pipe_file(f"{self.root}/{path}", content)

    def put(self, local: Path, path: str) -> int:
        """Copy a file into the store; return its size in bytes."""
        if self.system is None:
            self.write(path, local.read_bytes())
        else:
            with self._named("write", path):
                self.system.put_file(os.fspath(local), f"{self.root}/{path}")
        return local.stat().st_size

    def remove(self, path: str) -> None:
        """Remove a file; one that is not there is no error."""
        with suppress(FileNotFoundError, SourceNotFoundError), self._named("remove", path):
            if self.system is None:
                Path(self.root, path).unlink()
            else:
                self.system.rm_file(f"{self.root}/{path}")

    def files(self, folder: str) -> Iterator[tuple[str, int]]:
        """Yield path and size in bytes of all files below a folder, relative to the store."""
        if self.system is None:
            yield from self._files_on_disk(folder)
            return
        with self._named("read", folder):
            self.system.invalidate_cache()
            there = self.system.exists(f"{self.root}/{folder}")
            found = self.system.find(f"{self.root}/{folder}", detail=True) if there else {}
        for path, details in sorted(found.items()):
            yield path[len(self.root) + 1 :], int(details["size"])

    def _files_on_disk(self, folder: str) -> Iterator[tuple[str, int]]:
        def refuse(error: OSError) -> None:
            if not isinstance(error, FileNotFoundError):
                raise self._refusal("read", folder, error) from error

        top = Path(self.root)
        for place, folders, names in os.walk(top / folder, onerror=refuse):
            folders.sort()
            for name in sorted(names):
                if not name.startswith("."):
                    path = Path(place, name)
                    yield path.relative_to(top).as_posix(), path.stat().st_size

    def parts(self, table: str) -> Iterator[str]:
        """Yield the paths of the parts of a table."""
        return (path for path, _ in self.files(table) if path.endswith(".parquet"))

    def dataset(self, table: str, parts: Sequence[str] | None = None) -> pads.Dataset:
        """Return a table, or some parts of it, as a dataset of Arrow, with `vehicle` and `month` as texts."""
        texts = pa.schema([("vehicle", pa.string()), ("month", pa.string())])
        system = LocalFileSystem() if self.system is None else PyFileSystem(FSSpecHandler(self.system))
        return pads.dataset(
            list(self.parts(table) if parts is None else parts),
            schema=pa.schema([*TABLES[table], *texts]),
            format="parquet",
            filesystem=SubTreeFileSystem(self.root, system),
            partitioning=pads.HivePartitioning(texts, segment_encoding="uri"),
        )

    def write_part(self, path: str, rows: pa.Table) -> None:
        """Write a part of a table, whole or not at all."""
        buffer = BytesIO()
        pq.write_table(rows, buffer, compression="zstd")
        self.write(path, buffer.getvalue())

    @contextmanager
    def _named(self, what: Literal["read", "write", "remove"], path: str) -> Iterator[None]:
        """Turn a failure of the disk or the bucket into StorageError, unless a file to read or remove is not there."""
        named = remote_failures_named(f"{self}/{path}", scheme_of(self.address)) if self.system else nullcontext()
        try:
            with named:
                yield
        except (MultilicaError, OSError) as error:
            if what != "write" and isinstance(error, FileNotFoundError | SourceNotFoundError):
                raise
            raise self._refusal(what, path, error) from error

    def _refusal(self, what: str, path: str, error: MultilicaError | OSError) -> StorageError:
        if isinstance(error, OSError):
            remedy = "give a folder" if isinstance(error, NotADirectoryError) else "free space or permit access"
            told = f"{self}/{path} ({error.strerror or error}); {remedy}"
        else:
            told = str(error).rstrip(".") + _code_of(error)
        passes = isinstance(error, ConnectionLostError)
        return StorageError(f"The store cannot be used to {what} a file: {told}.", passes=passes)


def _part_of(log: LogRow) -> str:
    return f"vehicle={folder_name(log.vehicle)}/month={month_of(log.time_ns)}/{log.key}.parquet"


def _code_of(error: BaseException | None) -> str:
    """Return the error code of S3 behind a refusal, such as ``QuotaExceeded``, in brackets; empty if there is none."""
    while error is not None:
        response = getattr(error, "response", None)
        code = response.get("Error", {}).get("Code") if isinstance(response, dict) else None
        if isinstance(code, str) and code.isalnum():
            return f" ({code})"
        error = error.__cause__
    return ""


def open_store(address: str | Path, *, create: bool) -> Store:
    """Open a store, or lay out a new one.

    Args:
        address: a folder, or ``s3://BUCKET/PREFIX`` or ``gs://BUCKET/PREFIX``.
        create: make it if it is not there.

    Raises:
        UsageError: another kind of address, or a folder with other things in it.
        SourceNotFoundError: there is no store, and it is not to be created.
        UnreadableSourceError: the store is of a newer version.
        StorageError: the disk or the bucket refuses, or does not answer.
    """
    address = str(address)
    if not (scheme := scheme_of(address)):
        store = Store(address, None, str(local_path(address).absolute()))
    elif scheme in _BUCKETS:
        with needed_for(f"The store {without_secrets(address)}", _BUCKETS[scheme]):
            system, path = open_file_system(address)
        store = Store(address, system, path.rstrip("/"))
    else:
        shown = without_secrets(address)
        raise UsageError(f"A store is a folder, or lies at s3://BUCKET/PREFIX or gs://BUCKET/PREFIX; found {shown}.")
    try:
        found = json.loads(store.read(_LAYOUT))
        version = found["schema_version"]
    except SourceNotFoundError:
        if not create:
            raise SourceNotFoundError(
                f"There is no fleet store at {store}; `multilica fleet run LOGS --out {store}` makes one."
            ) from None
        _lay_out(store)
        return store
    except (ValueError, KeyError, TypeError) as error:
        raise UnreadableSourceError(f"{store}/{_LAYOUT} cannot be read; expected its format and version.") from error
    if version != SCHEMA_VERSION:
        raise UnreadableSourceError(
            f"The store {store} has version {version!r:.20} of the tables; this multilica reads and writes "
            f"{SCHEMA_VERSION}; use the version that wrote it, or another store."
        )
    return store


def _lay_out(store: Store) -> None:
    if store.system is None:
        folder = Path(store.root)
        others = folder.exists() and (not folder.is_dir() or any(each.name[0] != "." for each in folder.iterdir()))
        if others and not store.exists(_LAYOUT):  # another driver may be laying it out
            raise UsageError(f"{store} is not a fleet store, and not empty; give a new or an empty folder.")
    values = {"format": _FORMAT, "schema_version": SCHEMA_VERSION}
    store.write(_LAYOUT, (json.dumps(values, indent=2) + "\n").encode())
