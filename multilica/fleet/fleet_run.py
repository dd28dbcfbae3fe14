# SPDX-License-Identifier: Apache-2.0
"""A run over the logs of a fleet."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow as pa

import multilica
from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.errors import StorageError
from multilica.fleet.listing import FleetLog, LogPattern, find_logs
from multilica.fleet.store.records import PASSING, LogRow
from multilica.fleet.store.store import Store, vehicle_name
from multilica.fleet.tasks.guard import Calibrate, LogTask, LogTaskLimits, identify_guarded, open_executor, run_guarded
from multilica.ingest.metadata import LogIdentity
from multilica.ingest.remote.address import scheme_of
from multilica.optional_libraries import needed_for
from multilica.scratch import scratch_folder

with needed_for("`multilica fleet`", "duckdb"):
    import duckdb

# Tasks that wait at the executor for each that runs, so that none waits for the driver.
_AHEAD = 2
# Settings that change no result.
_INDIFFERENT = {"runtime": {"workers"}, "record": {"detail", "max_megabytes"}}
_BATCH = 2000
_PARTS = 500
_MEMORY = "256MB"
_DONE_COLUMNS = ["key", "source", "fingerprint", "vehicle", "time", "state", "reason", "calibration"]
_DONE_COLUMNS += ["config_sha256", "version"]
_TEXTS = ("address", "source", "fingerprint", "vehicle", "key")
_LOGS = pa.schema(
    [
        (name, pa.string() if name in _TEXTS else pa.int64())
        for name in (*(field.name for field in fields(FleetLog)), "key")
    ]
)

RunLogTask = Callable[[LogTask, LogTaskLimits], LogRow]


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Treatment of each log, and its place.

    Args:
        config: of reading and calibration; each task uses one thread.
        tolerances: within which a log verifies the vehicle's last accepted poses.
        calibrate: ``when-needed``: only where verification fails or there are no poses yet.
        workers: tasks at once on this machine, or at the `scheduler`, the address of one of Dask.
    """

    config: CalibrationConfig = field(default_factory=CalibrationConfig)
    tolerances: RigTolerances = field(default_factory=RigTolerances)
    calibrate: Calibrate = "when-needed"
    pattern: LogPattern | None = None
    newest_first: bool = False
    workers: int = 1
    scheduler: str = ""
    limits: LogTaskLimits = field(default_factory=LogTaskLimits)


@dataclass(slots=True)
class FleetOutcome:
    """Outcome of a run so far: logs per state, those of earlier runs as `skipped`, and those unlike the pattern."""

    found: int = 0
    skipped: int = 0
    unlike_pattern: int = 0
    states: dict[str, int] = field(default_factory=dict)

    def count_unlike(self, _: FleetLog) -> None:
        """Count a log that the pattern does not fit."""
        self.unlike_pattern += 1

    @property
    def without_result(self) -> int:
        """Logs of this run that are refused or failed."""
        return self.states.get("refused", 0) + self.states.get("failed", 0)


FleetObserver = Callable[[FleetOutcome | LogRow], None]
"""Called in the thread of `run_fleet`: once all logs are found, then with the row of each finished log."""


def run_fleet(
    logs: Sequence[str],
    store: Store,
    options: FleetOptions,
    observe: FleetObserver = lambda _: None,
    run_log_task: RunLogTask = run_guarded,
) -> FleetOutcome:
    """Verify or calibrate every log that the store does not have, and write rows and files of it into the store.

    The logs of a vehicle run one after the other, by time, as each is verified against the poses that the last
    accepted calibration before it gave; vehicles run beside each other. So the rows depend neither on the number of
    workers nor on interruptions.

    Args:
        logs: as `find_logs` takes them.
        run_log_task: run in a thread of this process or of a Dask worker.

    Raises:
        MultilicaError: as `find_logs` and `open_executor`.
        StorageError: the store or a disk is full or refuses. The log at hand has no row, so the next run goes on.
    """
    outcome, digest = FleetOutcome(), _config_digest(options.config, options.calibrate)
    with (
        scratch_folder() as folder,
        _full_disk_named(),
        open_executor(options.workers, options.scheduler) as (executor, slots),
        closing(Plan(folder, store, digest, newest_first=options.newest_first)) as plan,
    ):
        plan.add(find_logs(logs, options.pattern, outcome.count_unlike))
        plan.settle(lambda addresses: executor.map(partial(identify_guarded, limits=options.limits), addresses))
        outcome.found, to_do = plan.counts()
        outcome.skipped = outcome.found - to_do
        observe(outcome)
        vehicles = (_vehicle_tasks(plan.logs_of(vehicle), store, options, digest) for vehicle in plan.vehicles())
        for row in _run_vehicles(vehicles, executor, _AHEAD * slots, options.limits, run_log_task):
            outcome.states[row.state] = outcome.states.get(row.state, 0) + 1
            observe(row)
    return outcome


@contextmanager
def _full_disk_named() -> Iterator[None]:
    try:
        yield
    except duckdb.IOException as error:
        told = " ".join(str(error).split())[:200].rstrip(".")
        raise StorageError(
            f"The plan of the run cannot be kept ({told}); free space, or choose another TMPDIR."
        ) from error


def _config_digest(config: CalibrationConfig, calibrate: str) -> str:
    """Return the hash of all settings that a result depends on."""
    values = config.model_dump(mode="json", exclude=_INDIFFERENT)
    return hashlib.sha256(json.dumps([values, calibrate], sort_keys=True).encode()).hexdigest()[:16]


def _vehicle_tasks(
    logs: Iterator[QueuedLog], store: Store, options: FleetOptions, config_sha256: str
) -> Generator[LogTask, LogRow, None]:
    """Yield the tasks of a vehicle, each with the poses that hold before it; the row of each is sent back."""
    reference = ""
    for log in logs:
        if log.finished:
            reference = log.accepted or reference
            continue
        row = yield LogTask(
            **{name: value for name, value in asdict(log).items() if name not in ("finished", "accepted")},
            store=store.address if scheme_of(store.address) else str(Path(store.address).expanduser().absolute()),
            config=options.config,
            config_sha256=config_sha256,
            tolerances=options.tolerances,
            calibrate=options.calibrate,
            reference=reference,
        )
        reference = row.calibration or reference


def _run_vehicles(
    vehicles: Iterator[Generator[LogTask, LogRow, None]],
    executor: Executor,
    most: int,
    limits: LogTaskLimits,
    run_log_task: RunLogTask,
) -> Iterator[LogRow]:
    """Run one log of each of several vehicles at a time; yield the row of each as it ends."""
    running: dict[Future[LogRow], Generator[LogTask, LogRow, None]] = {}

    def start(vehicle: Generator[LogTask, LogRow, None], task: LogTask | None) -> None:
        if task is not None:
            running[executor.submit(run_log_task, task, limits)] = vehicle

    while True:
        while len(running) < most and (vehicle := next(vehicles, None)) is not None:
            start(vehicle, next(vehicle, None))
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            vehicle, row = running.pop(future), future.result()
            with suppress(StopIteration):
                start(vehicle, vehicle.send(row))
            yield row


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
        newest_first: whether each vehicle's logs go from the newest to the oldest.
    """

    def __init__(self, folder: Path, store: Store, config_sha256: str, *, newest_first: bool = False) -> None:
        self._base = duckdb.connect(str(folder / "plan.duckdb"))
        self._base.execute(f"SET memory_limit='{_MEMORY}'; SET threads=1; SET temp_directory='{folder}'")
        columns = ", ".join(f"{name} {'VARCHAR' if name in _TEXTS else 'BIGINT'}" for name in _LOGS.names)
        self._base.execute(f"CREATE TABLE found ({columns})")
        self._base.execute(
            "CREATE TABLE done (key VARCHAR, source VARCHAR, fingerprint VARCHAR, vehicle VARCHAR, "
            "time_ns BIGINT, accepted VARCHAR)"
        )
        self._config_sha256, self._order = config_sha256, "DESC" if newest_first else "ASC"
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
                             AND NOT (state = 'failed' AND list_contains($3, reason))""",
            [self._config_sha256, multilica.__version__, list(PASSING)],
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
                    named = vehicle_name(log.vehicle) if log.vehicle else PurePosixPath(source).parent.name or "unknown"
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
