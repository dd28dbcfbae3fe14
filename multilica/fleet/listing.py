# SPDX-License-Identifier: Apache-2.0
"""The logs that a user names: files, folders, globs, prefixes in buckets, and manifests."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from glob import has_magic
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from multilica.documents import local_path
from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.fleet.manifest import MANIFEST_SUFFIXES, read_manifest
from multilica.fleet.patterns import LogPattern
from multilica.fleet.sources import ListedLog, longer_sources
from multilica.fleet.store.store import is_store, vehicle_name
from multilica.ingest.formats import named_content
from multilica.ingest.remote.address import require_readable, scheme_of, without_secrets
from multilica.ingest.remote.remote_file import open_file_system, remote_failures_named

_END_BYTES = 1 << 20
_BAG = "metadata.yaml"
_RESULTS = ("result.mcap", "result.partial.mcap")
_BESIDE_RESULTS = ("result.json", "recording.rrd", "recording.partial.rrd")
_STORED_RESULT = re.compile(r"runs/[^/]+/[^/]+/[0-9a-f]{32}/result\.mcap$")


@dataclass(frozen=True, slots=True)
class FleetLog:
    """A log of a vehicle, with the latter's name and the time of its beginning if manifest or pattern gives them.

    Args:
        address: path or address that it is read from.
        source: the same for tables: the path below what was given, or the address without secrets.
        fingerprint: of its content, without reading all of it.
    """

    address: str
    source: str
    size_bytes: int
    fingerprint: str
    vehicle: str = ""
    time_ns: int | None = None


def find_logs(
    given: Sequence[str], pattern: LogPattern | None = None, unlike: Callable[[FleetLog], None] = lambda _: None
) -> Iterator[FleetLog]:
    """Yield the logs in what was given, each once it is found.

    Args:
        given: files, folders (searched to their ends), globs, ``s3://`` or ``gs://`` prefixes and globs, addresses of
            files, or CSV or Parquet manifests with the columns `source` and, if known, `vehicle` and `time`.
        pattern: vehicle and time in the paths of logs; what a manifest says comes first.
        unlike: called with each log that the pattern does not fit.

    Raises:
        UsageError: nothing was given, an address of another kind, or, at the end, a pattern that fits no log.
        SourceNotFoundError: nothing exists there.
        UnreadableSourceError: a manifest or a bucket cannot be read.
    """
    if not given:
        raise UsageError("No logs were given; expected folders, files, globs, s3:// prefixes or a manifest.")
    first, fits = "", 0
    longer = _longer_sources(given)
    for log in (log for each in given for log in _found(each, longer)):
        found = pattern.of(log.source) if pattern else None
        if pattern and found is None:
            unlike(log)
        first, fits = first or log.source, fits + (found is not None)
        vehicle, time_ns = found or ("", None)
        name = log.vehicle or vehicle
        time_ns = time_ns if log.time_ns is None else log.time_ns
        yield replace(log, vehicle=vehicle_name(name) if name else "", time_ns=time_ns)
    if pattern and first and not fits:
        raise UsageError(f"The pattern '{pattern.text}' fits no log; the first of them is {first}.")


def _longer_sources(given: Sequence[str]) -> dict[tuple[str, str], str]:
    """Return the sources of logs on this machine that would share one; one folder or glob has none."""
    local = [each for each in given if not scheme_of(each)]
    if len(local) == 1 and Path(local[0]).suffix not in MANIFEST_SUFFIXES:
        return {}
    return longer_sources(log for each in local for log in _listed(each))


def _found(given: str, longer: Mapping[tuple[str, str], str]) -> Iterator[FleetLog]:
    scheme = scheme_of(given)
    if not scheme:
        yield from (_read(log, longer) for log in _listed(given))
        return
    require_readable(given)
    if Path(urlsplit(given).path).suffix in MANIFEST_SUFFIXES:
        raise UsageError(f"The manifest {without_secrets(given)} is an address; expected a file on this machine.")
    yield from _in_bucket(given) if scheme in ("s3", "gs") else [_behind(given)]


def _listed(given: str) -> Iterator[ListedLog]:
    path = local_path(given)
    if path.suffix in MANIFEST_SUFFIXES and path.is_file():
        yield from _in_manifest(path)
    elif path.is_dir():
        yield from (_local(each, path) for each in _logs_below(path))
    elif path.is_file():
        yield _local(path, path.parent)
    elif path.exists():
        raise UnreadableSourceError(f"{given} is neither a file nor a folder.")
    elif has_magic(given):
        yield from _matching(given, path)
    else:
        raise SourceNotFoundError(f"Nothing exists at {given}.")


def _matching(given: str, path: Path) -> Iterator[ListedLog]:
    fixed = next(index for index, part in enumerate(path.parts) if has_magic(part))
    base, glob = Path(*path.parts[:fixed]), str(Path(*path.parts[fixed:]))
    found = sorted(each for each in base.glob(glob) if not each.name.startswith("."))
    if not found:
        raise SourceNotFoundError(f"No file matches {given}.")
    for each in found:
        if any(is_store(base / folder) for folder in each.relative_to(base).parents):
            continue
        if each.is_dir():
            yield from (_local(log, base) for log in _logs_below(each))
        elif each.is_file() and not _is_result(each):
            yield _local(each, base)


def _logs_below(folder: Path, above: frozenset[Path] = frozenset()) -> Iterator[Path]:
    """Yield recordings, bags and folders of point files; a link to a folder above leads nowhere, nor does a store."""
    real = folder.resolve()
    if real in above or is_store(folder):
        return
    if (folder / _BAG).is_file():
        yield folder
        return
    entries = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
    logs = (log for each in entries for log in _logs_at(each, above | {real}))
    if not any(named_content(each) == "cloud" for each in entries if each.is_file()):
        yield from logs
        return
    # Point files beside recordings are exports, say, and no log.
    found = [*logs]
    yield from found if any(not each.is_dir() or (each / _BAG).is_file() for each in found) else [folder]


def _logs_at(path: Path, above: frozenset[Path]) -> Iterator[Path]:
    if path.is_dir():
        yield from _logs_below(path, above)
    elif (path.is_file() or not path.exists()) and named_content(path) == "recording" and not _is_result(path):
        yield path


def _is_result(path: Path) -> bool:
    """Return whether a file is the result of a run, which holds the scans of a log once more."""
    return path.name in _RESULTS and any((path.parent / name).exists() for name in _BESIDE_RESULTS)


def _local(path: Path, base: Path) -> ListedLog:
    """Return a log below a folder, or a bag that was given itself; its source begins with the folder's name."""
    if path == base:
        path = path.resolve() if path.name in ("", "..") else path.absolute()
        base = path.parent
    folder, below = base.resolve(), path.relative_to(base)
    return ListedLog(os.fspath(path.absolute()), (folder.name / below).as_posix(), os.fspath(folder / below))


def _in_manifest(manifest: Path) -> Iterator[ListedLog]:
    for row in read_manifest(manifest):
        if scheme_of(row.source):
            yield ListedLog(row.source, "", "", row.vehicle, row.time_ns)
            continue
        listed = Path(row.source)
        named = Path(*listed.parts[-2:]) if listed.is_absolute() or ".." in listed.parts else listed
        address = (manifest.parent / listed).absolute()
        whole = os.path.abspath(address)  # noqa: PTH100 - a missing file fails later, as one of many
        yield ListedLog(os.fspath(address), named.as_posix(), whole, row.vehicle, row.time_ns)


def _read(log: ListedLog, longer: Mapping[tuple[str, str], str]) -> FleetLog:
    if not log.path:
        return replace(_behind(log.address), vehicle=log.vehicle, time_ns=log.time_ns)
    try:
        size, fingerprint = _fingerprint(Path(log.address))
    except OSError as error:
        size, fingerprint = 0, f"unreadable: {error.strerror}"
    source = longer.get((log.source, log.path), log.source)
    return FleetLog(log.address, source, size, fingerprint, log.vehicle, log.time_ns)


def _in_bucket(given: str) -> Iterator[FleetLog]:
    """Yield the recordings below a prefix, a folder with a ROS 2 bag as one; its address ends in ``/``."""
    scheme = scheme_of(given)
    with remote_failures_named(without_secrets(given), scheme):
        system, path = open_file_system(given)
        found: dict[str, Mapping[str, Any]] = (
            system.glob(path, detail=True) if has_magic(path) else system.find(path, detail=True)
        )
        for folder in [each for each, details in found.items() if details["type"] == "directory"]:
            del found[folder]
            found |= system.find(folder, detail=True)
    logs: dict[str, list[str]] = {}
    bags = _bags(found)
    for each in sorted(each for each in found if not _is_result_of(each, found)):
        bag = next((f"{above}/" for above in reversed(PurePosixPath(each).parents) if str(above) in bags), "")
        if named_content(Path(each)) == "recording" or bag:
            logs.setdefault(bag or each, []).append(each)
    if not logs:
        raise SourceNotFoundError(f"There is no recording at {without_secrets(given)}.")
    for log, files in logs.items():
        address, tags = f"{scheme}://{log}", [_tag(found[each]) for each in files]
        size = sum(int(found[each]["size"]) for each in files)
        if log not in found:
            lines = (f"{each.removeprefix(log)} {tag}\n" for each, tag in zip(files, tags, strict=True))
            tags = [hashlib.sha256("".join(lines).encode()).hexdigest()[:32]]
        yield FleetLog(address, address, size, tags[0])


def _bags(files: Iterable[str]) -> set[str]:
    """Return the folders with the metadata and with a file of a ROS 2 bag."""
    folders: dict[bool, set[str]] = {True: set(), False: set()}
    for each in map(PurePosixPath, files):
        if each.name == "metadata.yaml" or named_content(Path(each)) == "recording":
            folders[each.name == "metadata.yaml"].add(str(each.parent))
    return folders[True] & folders[False]


def _is_result_of(path: str, files: Container[str]) -> bool:
    """Return whether a file in a bucket is the result of a run; a glob finds those of a store without their folder."""
    folder, _, name = path.rpartition("/")
    beside = name in _RESULTS and any(f"{folder}/{each}" in files for each in _BESIDE_RESULTS)
    return beside or _STORED_RESULT.search(path) is not None


def _tag(details: Mapping[str, Any]) -> str:
    """Return what a server tells of the content of a file."""
    return str(details.get("ETag") or details.get("etag") or details.get("md5Hash") or "").strip('"')


def _behind(address: str) -> FleetLog:
    """Return a file at an address; what tells a change of it is known only when it is read."""
    source = without_secrets(address)
    return FleetLog(address, source, 0, hashlib.sha256(source.encode()).hexdigest()[:32])


def _fingerprint(path: Path) -> tuple[int, str]:
    """Return size in bytes and fingerprint of a file, or of the files of a folder: of each its first and last MiB."""
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    digest, total = hashlib.sha256(), 0
    for file in files:
        size = file.stat().st_size
        digest.update(f"{file.relative_to(path)} {size}\n".encode(errors="replace"))
        with file.open("rb") as stream:
            digest.update(stream.read(_END_BYTES))
            if size > _END_BYTES:
                stream.seek(max(size - _END_BYTES, _END_BYTES))
                digest.update(stream.read(_END_BYTES))
        total += size
    return total, digest.hexdigest()[:32]
