# SPDX-License-Identifier: Apache-2.0
"""Upkeep of a store: small parts, old recordings, a catalog."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath

import pyarrow as pa

from multilica.errors import SourceNotFoundError
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import TABLES
from multilica.fleet.store.repair import read_part
from multilica.fleet.store.store import Store, folder_name

_LARGE = ("recording.rrd", "report.html", "result.mcap")
_RUNS = """
SELECT vehicle, time, key, recording FROM logs WHERE recording <> '' AND finished_at IS NOT NULL
ORDER BY vehicle, time, key
"""
_EVERY_RUN = """
SELECT recording, finished_at, bool_and(coalesce(lidars.status = 'placed', true) AND state = 'calibrated') AS succeeded
FROM logs_parts LEFT JOIN lidars_parts AS lidars USING (key) WHERE recording <> '' AND finished_at IS NOT NULL
GROUP BY ALL ORDER BY recording
"""
"""Those of earlier configurations as well."""


def prune_recordings(
    store: Store, *, success_days: float, failure_days: float, now: datetime | None = None
) -> tuple[int, int]:
    """Remove recordings, reports and MCAP files of runs that finished longer ago; rows and poses are kept.

    Args:
        success_days: for runs that placed every LiDAR.
        failure_days: for the others.

    Returns:
        The number of files that were removed, and their bytes.
    """
    now, files, size_bytes = now or datetime.now(UTC), 0, 0
    sizes = dict(store.files("runs"))
    with ask(store, _EVERY_RUN) as answer:
        for recording, finished_at, succeeded in answer.rows():
            age = now - finished_at
            if age > timedelta(days=success_days if succeeded else failure_days):
                folder = recording.rpartition("/")[0]
                for path in (f"{folder}/{name}" for name in _LARGE):
                    if path in sizes:
                        store.remove(path)
                        files, size_bytes = files + 1, size_bytes + sizes[path]
    return files, size_bytes


def lay_out_catalog(store: Store, folder: Path, vehicle: str | None = None) -> dict[str, Path]:
    """Lay out the recordings in a folder per vehicle: as links, or as copies of those in a bucket.

    Args:
        vehicle: only this one.

    Returns:
        The folder of each vehicle, by name.

    Raises:
        SourceNotFoundError: there is no recording.
    """
    folders: dict[str, Path] = {}
    with ask(store, _RUNS) as answer:
        for name, time, key, recording in answer.rows():
            if vehicle in {None, name} and store.exists(recording):
                folders.setdefault(name, folder / folder_name(name)).mkdir(parents=True, exist_ok=True)
                day = "unknown" if time is None else f"{time:%Y-%m-%d_%H%M%S}"
                place = folders[name] / f"{day}_{key[:8]}.rrd"
                if store.system is None:
                    place.symlink_to(Path(store.root, recording))
                else:
                    place.write_bytes(store.read(recording))
    if not folders:
        whose = f" of {vehicle}" if vehicle else ""
        raise SourceNotFoundError(f"The store {store} has no recordings{whose}; logs that verify have none.")
    return folders


def compact_store(store: Store) -> tuple[int, int]:
    """Join the parts of each table, vehicle and month into one; return the number of parts before and after.

    The joined part is whole before the parts in it are removed. Between the two, a row stands twice, which readers of
    this library tell by its key; after a kill, the next call goes on. `LIDARS` come first, so that a log that is there
    always has its rows.
    """
    before = after = 0
    for table in TABLES:
        folders: dict[str, list[str]] = defaultdict(list)
        for path in store.parts(table):
            folders[str(PurePosixPath(path).parent)].append(path)
        for folder, parts in folders.items():
            before, after = before + len(parts), after + 1
            if len(parts) > 1:
                digest = hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:32]
                joined = f"{folder}/joined-{digest}.parquet"
                rows = pa.concat_tables([read_part(store, path) for path in parts])
                store.write_part(joined, _distinct(rows))
                for path in sorted({*parts} - {joined}):
                    store.remove(path)
    return before, after


def _distinct(rows: pa.Table) -> pa.Table:
    """Keep one of rows that a compaction that was killed has left twice."""
    identity = ["key", "lidar"] if "lidar" in rows.column_names else ["key"]
    numbered = rows.append_column("row", pa.array(range(len(rows))))
    return rows.take(numbered.group_by(identity).aggregate([("row", "min")])["row_min"].sort())
