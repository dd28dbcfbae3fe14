# SPDX-License-Identifier: Apache-2.0
"""Damaged parts of a store: found, and set aside together with the rows that need them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import PurePosixPath
from urllib.parse import unquote

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from multilica.errors import UnreadableSourceError
from multilica.fleet.store.records import TABLES
from multilica.fleet.store.store import Store

ASIDE = "damaged"
"""Folder of a store that damaged parts are moved to."""
_WITH_ROWS = ("verified", "calibrated")


@dataclass(frozen=True, slots=True)
class Repair:
    """Outcome of `repair_store`.

    Args:
        parts: paths of the damaged parts, which are now below `ASIDE`.
        logs: vehicle and source of the logs that the next run treats again.
        unnamed: the number of damaged parts of `logs` that may hold further logs, whose names are lost.
    """

    parts: tuple[str, ...]
    logs: tuple[tuple[str, str], ...]
    unnamed: int


def damaged_part(store: Store, path: str) -> UnreadableSourceError:
    """Return the error of a part that cannot be read."""
    return UnreadableSourceError(
        f"The part {path} of the store {store} is damaged; `multilica fleet repair --store {store}` sets it aside, and "
        "the next `multilica fleet run` treats its logs again."
    )


def read_part(store: Store, path: str) -> pa.Table:
    """Read all rows of a part; raise UnreadableSourceError if it is damaged."""
    content = BytesIO(store.read(path))
    try:
        # Arrow's threads for reading may outlive the interpreter, which aborts then.
        rows = pq.read_table(content, use_threads=False, pre_buffer=False)
        return rows.cast(TABLES[path.partition("/")[0]])
    except (pa.ArrowException, OSError, ValueError) as error:
        raise damaged_part(store, path) from error


def damaged_parts(store: Store) -> list[str]:
    """Read all parts of a store; return the paths of those that are damaged."""
    return [path for table in TABLES for path in store.parts(table) if not _is_whole(store, path)]


def repair_store(store: Store) -> Repair:
    """Move damaged parts to the folder `ASIDE`, and remove the rows of logs whose LiDARs were in them.

    So the next run treats these logs again. Logs come first, so that after a kill the next call goes on.
    """
    damaged = damaged_parts(store)
    logs: set[tuple[str, str]] = set()
    for folder in dict.fromkeys(str(PurePosixPath(path).parent).partition("/")[2] for path in damaged):
        vehicle = unquote(folder.split("/")[0].partition("=")[2])
        logs |= {(vehicle, source) for source in _sources_to_treat(store, folder, damaged)}
    for path in damaged:
        store.write(f"{ASIDE}/{path}", store.read(path))
        store.remove(path)
    return Repair(tuple(damaged), tuple(sorted(logs)), sum(path.startswith("logs/") for path in damaged))


def _sources_to_treat(store: Store, folder: str, damaged: Sequence[str]) -> Iterator[str]:
    """Remove the rows of logs without their LiDARs; yield their sources, and those of LiDARs without their log."""
    lidars, logs = (
        [(path, read_part(store, path)) for path in store.parts(f"{table}/{folder}") if path not in damaged]
        for table in ("lidars", "logs")
    )
    with_lidars = pa.array([key for _, rows in lidars for key in rows["key"].to_pylist()], pa.string())
    finished: set[str] = set()
    for path, rows in logs:
        needs = pc.is_in(rows["state"], pa.array(_WITH_ROWS))
        lost = pc.and_(needs, pc.invert(pc.is_in(rows["key"], with_lidars)))
        kept = rows.filter(pc.invert(lost))
        if len(kept) < len(rows):
            yield from rows.filter(lost)["source"].to_pylist()
            if len(kept):
                store.write_part(path, kept)
            else:
                store.remove(path)
        finished.update(kept["key"].to_pylist())
    for _, rows in lidars:
        yield from (row["source"] for row in rows.select(["key", "source"]).to_pylist() if row["key"] not in finished)


def _is_whole(store: Store, path: str) -> bool:
    try:
        read_part(store, path)
    except UnreadableSourceError:
        return False
    return True
