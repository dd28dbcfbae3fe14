# SPDX-License-Identifier: Apache-2.0
"""Joining of small parts."""

from __future__ import annotations

from collections import defaultdict
from io import BytesIO
from pathlib import PurePosixPath

import pyarrow as pa
import pyarrow.parquet as pq

from multilica.fleet.store.store import TABLES, Store, damaged_part


def compact_store(store: Store) -> tuple[int, int]:
    """Join the parts of each table, vehicle and month into one; return the number of parts before and after.

    The joined part is whole before the parts in it are removed. Between the two, a row stands twice, which readers of
    this library tell by its key; after a kill, the next call goes on. `LIDARS` come first, so that a log that is there
    always has its rows.
    """
    before = after = 0
    for table, schema in TABLES.items():
        folders: dict[str, list[str]] = defaultdict(list)
        for path in store.parts(table):
            folders[str(PurePosixPath(path).parent)].append(path)
        for folder, parts in folders.items():
            before, after = before + len(parts), after + 1
            if len(parts) > 1:
                tables = [_part(store, path).cast(schema) for path in parts]
                _replace(store, parts, f"{folder}/joined-{_keys_digest(parts)}.parquet", pa.concat_tables(tables))
    return before, after


def _part(store: Store, path: str) -> pa.Table:
    try:
        return pq.read_table(BytesIO(store.read(path)))
    except pa.ArrowException as error:
        raise damaged_part(store, path) from error


def _replace(store: Store, parts: list[str], joined: str, rows: pa.Table) -> None:
    buffer = BytesIO()
    pq.write_table(_distinct(rows), buffer, compression="zstd")
    store.write(joined, buffer.getvalue())
    for path in parts:
        if path != joined:
            store.remove(path)


def _distinct(rows: pa.Table) -> pa.Table:
    """Keep one of rows that a compaction that was killed has left twice."""
    columns = ["key", "lidar"] if "lidar" in rows.column_names else ["key"]
    seen: set[tuple[object, ...]] = set()
    kept = []
    for index, identity in enumerate(zip(*(rows[name].to_pylist() for name in columns), strict=True)):
        if identity not in seen:
            seen.add(identity)
            kept.append(index)
    return rows.take(kept)


def _keys_digest(parts: list[str]) -> str:
    import hashlib

    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:32]
