# SPDX-License-Identifier: Apache-2.0
"""The order of the work of a fleet's run, in a database on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow as pa

import multilica
from multilica.errors import StorageError
from multilica.fleet.listing import FleetLog
from multilica.fleet.store.records import PASSING
from multilica.fleet.store.store import Store, vehicle_name
from multilica.fleet.tasks.guard import LogTaskLimits
from multilica.ingest.metadata import LogIdentity
from multilica.optional_libraries import needed_for

with needed_for("`multilica fleet`", "duckdb"):
    import duckdb

_BATCH = 2000
_PARTS = 500
_MEMORY = "256MB"
_DONE_COLUMNS = ["key", "source", "fingerprint", "vehicle", "time", "state", "reason", "calibration"]
_DONE_COLUMNS += ["config_sha256", "version", "elapsed_s", "memory_mb"]
_TEXTS = ("address", "source", "fingerprint", "vehicle", "key")
_LOGS = pa.schema(
    [
        (name, pa.string() if name in _TEXTS else pa.int64())
        for name in (*(field.name for field in fields(FleetLog)), "key")
    ]
)


@contextmanager
def full_disk_named() -> Iterator[None]:
    """Turn the failure of the plan's database to write into StorageError."""
    try:
        yield
    except duckdb.IOException as error:
        told = " ".join(str(error).split())[:200].rstrip(".")
        raise StorageError(
            f"The plan of the run cannot be kept ({told}); free space, or choose another TMPDIR."
        ) from error


@dataclass(frozen=True, slots=True)
class QueuedLog(FleetLog):
    """A log in the order of its vehicle, with the key of its row.

    Args:
        finished: whether the store has that row.
        accepted: path in the store of poses that it gave; empty if it gave none.
    """

    key: str = ""
    finished: bool = False
    accepted: str = ""


class Plan:
    """The order of the work of a run: per vehicle its logs by time, with what the store has of them.

    It lies in a database on disk, so that its size in memory does not depend on the number of logs.

    Args:
        config_sha256: only rows of this configuration and version count as finished.
        limits: of the tasks; a log that ended at a smaller one is not finished.
        newest_first: whether each vehicle's logs go from the newest to the oldest.
    """

    def __init__(
        self, folder: Path, store: Store, config_sha256: str, limits: LogTaskLimits, *, newest_first: bool = False
    ) -> None:
        self._base = duckdb.connect(str(folder / "plan.duckdb"))
        self._base.execute(f"SET memory_limit='{_MEMORY}'; SET threads=1; SET temp_directory='{folder}'")
        columns = ", ".join(f"{name} {'VARCHAR' if name in _TEXTS else 'BIGINT'}" for name in _LOGS.names)
        self._base.execute(f"CREATE TABLE found ({columns})")
        self._base.execute(
            "CREATE TABLE done (key VARCHAR, source VARCHAR, fingerprint VARCHAR, vehicle VARCHAR, "
            "time_ns BIGINT, accepted VARCHAR)"
        )
        self._config_sha256, self._order = config_sha256, "DESC" if newest_first else "ASC"
        self._limits = limits
        parts = store.parts("logs")
        # Some at a time: what Arrow knows of each part takes memory.
        while some := list(islice(parts, _PARTS)):
            try:
                self._read_parts(store, some)
            except (pa.ArrowException, OSError):
                # The log of a damaged part is not finished; its part will be written again.
                for part in some:
                    with suppress(pa.ArrowException, OSError):
                        self._read_parts(store, [part])

    def _read_parts(self, store: Store, parts: Sequence[str]) -> None:
        """Read the rows of finished logs."""
        self._base.register("stored", store.dataset("logs", parts).to_table(columns=_DONE_COLUMNS))
        self._base.execute(
            """INSERT INTO done SELECT key, source, fingerprint, vehicle, epoch_ns(time) AS time_ns,
                 CASE WHEN state = 'calibrated' AND calibration LIKE '%' || key || '%' THEN calibration ELSE '' END
               FROM stored WHERE config_sha256 = $1 AND version = $2
                             AND NOT (state = 'failed' AND (list_contains($3, reason)
                               OR reason = 'timeout' AND elapsed_s < $4 OR reason = 'memory' AND memory_mb < $5))""",
            [self._config_sha256, multilica.__version__, list(PASSING), self._limits.time_s, self._limits.memory_mb],
        )
        self._base.unregister("stored")

    def add(self, logs: Iterable[FleetLog]) -> None:
        """Add logs."""
        waiting = iter(logs)
        while batch := list(islice(waiting, _BATCH)):
            values = [{"key": _log_key(log, self._config_sha256)} | asdict(log) for log in batch]
            self._base.register("batch", pa.Table.from_pylist(values, schema=_LOGS))
            self._base.execute(f"INSERT INTO found SELECT {', '.join(_LOGS.names)} FROM batch")  # noqa: S608
            self._base.unregister("batch")

    def settle(self, identify: Callable[[Sequence[str]], Iterable[LogIdentity]]) -> None:
        """Find vehicle and time of the logs that lack one: from the store, else by reading them at their addresses."""
        self._base.execute(
            "DELETE FROM found WHERE rowid NOT IN (SELECT min(rowid) FROM found GROUP BY key);"
            "UPDATE found SET vehicle = done.vehicle, time_ns = done.time_ns FROM done WHERE found.key = done.key"
        )
        lacking = """SELECT key, address, source, vehicle, time_ns FROM found
            WHERE (vehicle = '' OR time_ns IS NULL) AND key NOT IN (SELECT key FROM done) ORDER BY source"""
        with closing(self._base.cursor()) as cursor:
            cursor.execute(lacking)
            while rows := cursor.fetchmany(_BATCH):
                found = identify([address for _, address, *_ in rows])
                settled = []
                for (key, _, source, vehicle, begin_ns), log in zip(rows, found, strict=True):
                    named = vehicle_name(log.vehicle or PurePosixPath(source).parent.name)
                    settled.append((vehicle or named, log.time_ns if begin_ns is None else begin_ns, key))
                self._base.executemany("UPDATE found SET vehicle = ?, time_ns = ? WHERE key = ?", settled)

    def counts(self) -> tuple[int, int]:
        """Return the number of logs, and of those that are to be done."""
        counted = self._base.execute(
            "SELECT count(*), count(*) FILTER (key NOT IN (SELECT key FROM done)) FROM found"
        ).fetchone()
        assert counted is not None  # noqa: S101
        return counted[0], counted[1]

    def vehicles(self) -> Iterator[str]:
        """Yield the vehicles with something to do, by name."""
        todo = "SELECT DISTINCT vehicle FROM found WHERE key NOT IN (SELECT key FROM done) ORDER BY vehicle"
        return (vehicle for (vehicle,) in self._stream(todo))

    def logs_of(self, vehicle: str) -> Iterator[QueuedLog]:
        """Yield the logs of a vehicle in the order of the work, finished ones of earlier runs among them."""
        rows = self._stream(
            f"""WITH own AS (SELECT * FROM found WHERE vehicle = $1),
                     past AS (SELECT * FROM done WHERE vehicle = $1)
            SELECT own.*, past.key IS NOT NULL, coalesce(past.accepted, '')
            FROM own LEFT JOIN past ON own.key = past.key
            UNION ALL
            SELECT '', source, 0, fingerprint, vehicle, time_ns, key, true, accepted
            FROM past WHERE key NOT IN (SELECT key FROM own)
            ORDER BY time_ns {self._order} NULLS LAST, source, key""",  # noqa: S608 - no text from outside
            [vehicle],
        )
        return (QueuedLog(*row) for row in rows)

    def close(self) -> None:
        """Close the database."""
        self._base.close()

    def _stream(self, query: str, values: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        with closing(self._base.cursor()) as cursor:
            cursor.execute(query, list(values))
            while rows := cursor.fetchmany(_BATCH):
                yield from rows


def _log_key(log: FleetLog, config_sha256: str) -> str:
    """Return the key of a log's row: equal if the same source is treated by the same version in the same way."""
    identity = [log.source, log.size_bytes, log.fingerprint, config_sha256, multilica.__version__]
    return hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:32]
