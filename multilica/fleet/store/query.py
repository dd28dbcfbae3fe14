# SPDX-License-Identifier: Apache-2.0
"""Questions about the tables of a store."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.fleet.store.records import TABLES
from multilica.fleet.store.repair import damaged_part, damaged_parts
from multilica.fleet.store.store import Store
from multilica.optional_libraries import needed_for

with needed_for("`multilica fleet`", "duckdb"):
    import duckdb

_LONGEST = 300
_BATCH = 1000
_READING = "arrow_scan"
"""Word in errors of the database that come from a part, and not from the question."""
_VIEWS = """
SET TimeZone='UTC';
CREATE VIEW of_files AS SELECT * EXCLUDE (turn, succeeded) FROM (
  SELECT *, CASE WHEN starts_with(key, 'watch-') THEN time END AS watched,
         row_number() OVER (PARTITION BY source, fingerprint, watched ORDER BY state = 'failed', finished_at DESC, key)
           AS turn, bool_or(state <> 'failed') OVER (PARTITION BY source) AS succeeded
  FROM logs_parts) WHERE turn = 1 AND NOT (state = 'failed' AND succeeded);
CREATE VIEW logs AS SELECT * EXCLUDE (turn, watched) FROM (
  SELECT *, row_number() OVER (PARTITION BY vehicle, source, watched ORDER BY finished_at DESC, key) AS turn
  FROM of_files) WHERE turn = 1;
CREATE VIEW lidars AS SELECT DISTINCT ON (key, lidar) * FROM lidars_parts WHERE key IN (SELECT key FROM logs)
"""


@dataclass(frozen=True, slots=True, eq=False)
class QueryAnswer:
    """A table: names of the columns, and rows that are read when they are asked for."""

    columns: tuple[str, ...]
    batches: pa.RecordBatchReader

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows."""
        for batch in self.batches:
            yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)


@contextmanager
def ask(
    store: Store, sql: str, values: Sequence[object] = (), *, without: Collection[str] = ()
) -> Iterator[QueryAnswer]:
    """Answer a question in the SQL of DuckDB, with the tables `lidars` and `logs`.

    A log that was treated again stands there once, by its last row: by another version or configuration, as a log of
    another vehicle or time, or after the file grew. Each verdict of a watch is a log. A row of `lidars` is there if
    the row of its log is.

    Args:
        without: paths of parts that are left out.

    Raises:
        UsageError: the database does not understand it.
        UnreadableSourceError: a part is damaged.
    """
    with duckdb.connect() as base:
        for table in TABLES:
            base.register(
                f"{table}_parts", store.dataset(table, [path for path in store.parts(table) if path not in without])
            )
        base.execute(_VIEWS)
        try:
            done = base.execute(sql, list(values))
            if done is None:
                raise UsageError("The question is empty; expected SQL, for example: SELECT * FROM lidars LIMIT 10.")
            batches = done.fetch_record_batch(_BATCH)
            yield QueryAnswer(tuple(batches.schema.names), batches)
        except (duckdb.Error, pa.ArrowException) as error:
            if _READING in str(error) and (damaged := damaged_parts(store)):
                raise damaged_part(store, damaged[0]) from error
            text = " ".join(str(error).partition("\nLINE ")[0].split())[:_LONGEST].rstrip(".!")
            raise UsageError(f"The question cannot be answered: {text}.") from error


def ask_status(store: Store) -> tuple[QueryAnswer, list[str]]:
    """Answer `STATUS` from the parts that are whole; with the paths of damaged parts."""
    damaged: list[str] = []
    try:
        return _whole_answer(store, STATUS, damaged), damaged
    except UnreadableSourceError:
        damaged = damaged_parts(store)
        return _whole_answer(store, STATUS, damaged), damaged


def _whole_answer(store: Store, sql: str, without: Collection[str]) -> QueryAnswer:
    with ask(store, sql, without=without) as answer:
        return QueryAnswer(answer.columns, answer.batches.read_all().to_reader())


STATUS = """
SELECT logs.vehicle, count(*) AS logs, min(time) AS first, max(time) AS last,
       count(*) FILTER (state = 'verified') AS verified, count(*) FILTER (state = 'calibrated') AS calibrated,
       count(*) FILTER (state IN ('refused', 'failed')) AS without_result,
       count(*) FILTER (state = 'duplicate') AS duplicates,
       (SELECT string_agg(lidar || ': ' || reason, ', ' ORDER BY lidar) FROM lidars
        WHERE lidars.vehicle = logs.vehicle AND lidars.status <> 'placed'
          AND lidars.key = arg_max(logs.key, logs.time) FILTER (state IN ('verified', 'calibrated'))) AS not_placed_last
FROM logs GROUP BY logs.vehicle ORDER BY logs.vehicle
"""
"""Logs of each vehicle by outcome, and LiDARs that its last one does not place."""
FAILURES = """
SELECT vehicle, time, source, '' AS lidar, state AS outcome, reason, reason_text, recording FROM logs
WHERE state IN ('refused', 'failed')
UNION ALL
SELECT lidars.vehicle, lidars.time, lidars.source, lidar, status, lidars.reason, lidars.reason_text, recording
FROM lidars JOIN logs USING (key) WHERE status <> 'placed'
ORDER BY reason, vehicle, time, source, lidar
"""
"""Logs without a result and LiDARs without a certain pose, by cause, with their recordings."""
HISTORY = """
SELECT time, lidar, how, status, round(x_m, 4) AS x_m, round(y_m, 4) AS y_m, round(z_m, 4) AS z_m,
       round(degrees(atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))), 3) AS roll_deg,
       round(degrees(asin(greatest(-1, least(1, 2 * (qw * qy - qz * qx))))), 3) AS pitch_deg,
       round(degrees(atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))), 3) AS yaw_deg,
       round(sigma_mm, 2) AS sigma_mm, round(sigma_deg, 4) AS sigma_deg, target, reason, source
FROM lidars WHERE vehicle = ? ORDER BY time, source, lidar
"""
"""Poses of each LiDAR of a vehicle, log by log."""


def require_vehicle(store: Store, vehicle: str) -> None:
    """Raise SourceNotFoundError if the store has no log of a vehicle."""
    with ask(store, "SELECT DISTINCT vehicle FROM logs ORDER BY 1") as answer:
        names = [name for (name,) in answer.rows()]
    if vehicle not in names:
        shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
        raise SourceNotFoundError(f"The store {store} has no vehicle '{vehicle}'; it has {shown or 'none yet'}.")
