# SPDX-License-Identifier: Apache-2.0
"""The names of logs in tables, of which no two share one."""

from __future__ import annotations

import os.path
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class ListedLog:
    """A log before its content is read; `vehicle` and `time_ns` if a manifest gives them.

    Args:
        address: path or address that it is read from.
        source: its name in tables.
        path: absolute, without links in the folder that was given; empty at an address.
    """

    address: str
    source: str
    path: str = ""
    vehicle: str = ""
    time_ns: int | None = None


def longer_sources(logs: Iterable[ListedLog]) -> dict[tuple[str, str], str]:
    """Return the sources of different files that would share one, as ends of their paths that tell them apart.

    Returns:
        (source, path) -> longer source. Logs with a source of their own keep it, as it names them across runs.
    """
    first: dict[str, str] = {}
    shared: dict[str, set[str]] = {}
    for log in logs:
        if not log.path:
            continue
        path = first.setdefault(log.source, log.path)
        if path != log.path and os.path.realpath(path) != os.path.realpath(log.path):
            shared.setdefault(log.source, {path}).add(log.path)
    longer: dict[tuple[str, str], str] = {}
    for source, paths in shared.items():
        names = _ends_apart(paths, first)
        first |= {name: path for path, name in names.items()}
        longer |= {(source, path): name for path, name in names.items()}
    return longer


def _ends_apart(paths: Iterable[str], taken: Mapping[str, str]) -> dict[str, str]:
    """Return the shortest ends of absolute paths, all of as many parts, that differ and that name no other log."""
    parts = {path: Path(path).parts[1:] for path in paths}
    names: dict[str, str] = {}
    for count in range(2, max(map(len, parts.values())) + 1):
        names = {path: "/".join(each[-count:]) for path, each in parts.items()}
        if len({*names.values()}) == len(names) and all(taken.get(name, path) == path for path, name in names.items()):
            break
    return names
