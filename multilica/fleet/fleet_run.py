# SPDX-License-Identifier: Apache-2.0
"""A run over the logs of a fleet."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.fleet.logs.listing import LogPattern, find_logs
from multilica.fleet.logs.plan import Plan, QueuedLog
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import Store
from multilica.fleet.tasks.guard import Calibrate, LogTask, LogTaskLimits, identify_guarded, open_executor, run_guarded
from multilica.ingest.remote.address import scheme_of
from multilica.scratch import scratch_folder

# Tasks that wait at the executor for each that runs, so that none waits for the driver.
_AHEAD = 2
# Settings that change no result.
_INDIFFERENT = {"runtime": {"workers"}, "record": {"detail", "max_megabytes"}}

RunLogTask = Callable[[LogTask, LogTaskLimits], LogRow]


@dataclass(frozen=True, slots=True)
class LogsPlanned:
    """All logs are found: how many, and how many of them the store does not have yet."""

    found: int
    to_do: int


FleetObserver = Callable[[LogsPlanned | LogRow], None]
"""Called in the thread of `run_fleet`: once all logs are found, then with the row of each finished log."""


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
    """Outcome of a run: logs per state, those of earlier runs as `skipped`."""

    found: int = 0
    skipped: int = 0
    states: dict[str, int] = field(default_factory=dict)

    @property
    def without_result(self) -> int:
        """Logs of this run that are refused or failed."""
        return self.states.get("refused", 0) + self.states.get("failed", 0)


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
    """
    outcome, digest = FleetOutcome(), _config_digest(options.config, options.calibrate)
    with (
        scratch_folder() as folder,
        open_executor(options.workers, options.scheduler) as (executor, slots),
        closing(Plan(folder, store, digest, newest_first=options.newest_first)) as plan,
    ):
        plan.add(find_logs(logs, options.pattern))
        plan.settle(lambda addresses: executor.map(partial(identify_guarded, limits=options.limits), addresses))
        outcome.found, to_do = plan.counts()
        outcome.skipped = outcome.found - to_do
        observe(LogsPlanned(outcome.found, to_do))
        vehicles = (_vehicle_tasks(plan.logs_of(vehicle), store, options, digest) for vehicle in plan.vehicles())
        for row in _run_vehicles(vehicles, executor, _AHEAD * slots, options.limits, run_log_task):
            outcome.states[row.state] = outcome.states.get(row.state, 0) + 1
            observe(row)
    return outcome


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
