# SPDX-License-Identifier: Apache-2.0
"""A run over the logs of a fleet."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import closing
from dataclasses import dataclass, field

from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.fleet.logs.listing import LogPattern, find_logs
from multilica.fleet.logs.log import config_digest
from multilica.fleet.logs.plan import Plan, QueuedLog
from multilica.fleet.store.store import Store, vehicle_name
from multilica.fleet.tasks.executors import open_executor
from multilica.fleet.tasks.guard import LogTaskLimits, identify_guarded, run_guarded
from multilica.fleet.tasks.log_task import Calibrate, LogTask, LogTaskSummary
from multilica.scratch import scratch_folder

# Tasks that wait at the executor for each that runs, so that none waits for the driver.
_AHEAD = 2

RunLogTask = Callable[[LogTask, LogTaskLimits], LogTaskSummary]


@dataclass(frozen=True, slots=True)
class LogsPlanned:
    """All logs are found.

    Args:
        found: number of logs.
        to_do: those that the store does not have yet.
    """

    found: int
    to_do: int


@dataclass(frozen=True, slots=True)
class LogFinished:
    """A log has its rows in the store."""

    vehicle: str
    source: str
    summary: LogTaskSummary


FleetObserver = Callable[[LogsPlanned | LogFinished], None]


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """What is done with each log, and where.

    Args:
        config: of reading and calibration; each task uses one thread.
        tolerances: within which a log verifies the vehicle's last accepted poses.
        calibrate: ``when-needed``: only where verification fails or there are no poses yet.
        pattern: vehicle and time in the paths of logs.
        newest_first: whether the newest logs of each vehicle come first.
        workers: tasks at once on this machine.
        scheduler: address of a Dask scheduler instead.
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
    """How a run ended: logs per state, those of earlier runs as `skipped`."""

    found: int = 0
    skipped: int = 0
    states: dict[str, int] = field(default_factory=dict)
    elapsed_s: float = 0.0

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
        observe: called in this thread.
        run_log_task: run in a thread of this process or of a Dask worker.

    Raises:
        MultilicaError: as `find_logs` and `open_executor`.
    """
    start_s = time.monotonic()
    outcome, digest = FleetOutcome(), config_digest(options.config, options.calibrate)
    with (
        scratch_folder() as folder,
        open_executor(options.workers, options.scheduler) as (executor, slots),
        closing(Plan(folder, store, digest, newest_first=options.newest_first)) as plan,
    ):
        plan.add(find_logs(logs, options.pattern))
        plan.settle(lambda addresses: _identified(executor, addresses, options.limits))
        outcome.found, to_do = plan.counts()
        outcome.skipped = outcome.found - to_do
        observe(LogsPlanned(outcome.found, to_do))
        chains = (_Chain(plan.logs_of(vehicle), store, options, digest) for vehicle in plan.vehicles())
        for log, summary in _run_chains(chains, executor, _AHEAD * slots, options.limits, run_log_task):
            outcome.states[summary.state] = outcome.states.get(summary.state, 0) + 1
            observe(LogFinished(log.vehicle, log.source, summary))
    outcome.elapsed_s = time.monotonic() - start_s
    return outcome


def _identified(
    executor: Executor, addresses: Sequence[str], limits: LogTaskLimits
) -> Iterator[tuple[str, int | None]]:
    waiting: deque[Future[tuple[str, int | None]]] = deque()
    for address in addresses:
        waiting.append(executor.submit(_identify, address, limits))
    while waiting:
        yield waiting.popleft().result()


def _identify(address: str, limits: LogTaskLimits) -> tuple[str, int | None]:
    found = identify_guarded(address, limits)
    return (vehicle_name(found.vehicle) if found.vehicle else ""), found.time_ns


class _Chain:
    """The logs of a vehicle, each with the poses that hold before it."""

    def __init__(self, logs: Iterator[QueuedLog], store: Store, options: FleetOptions, config_sha256: str) -> None:
        self._logs, self._store, self._options, self._config_sha256 = logs, store, options, config_sha256
        self._reference = ""

    def next(self) -> LogTask | None:
        """Return what is to be done next; None at the end."""
        for log in self._logs:
            if not log.finished:
                return self._request(log)
            self._reference = log.accepted or self._reference
        return None

    def take(self, summary: LogTaskSummary) -> None:
        self._reference = summary.calibration or self._reference

    def _request(self, log: QueuedLog) -> LogTask:
        options = self._options
        return LogTask(
            key=log.key,
            address=log.address,
            source=log.source,
            fingerprint=log.fingerprint,
            size_bytes=log.size_bytes,
            vehicle=log.vehicle,
            time_ns=log.time_ns,
            store=self._store.address,
            config=options.config,
            config_sha256=self._config_sha256,
            tolerances=options.tolerances,
            calibrate=options.calibrate,
            reference=self._reference,
        )


def _run_chains(
    chains: Iterable[_Chain], executor: Executor, most: int, limits: LogTaskLimits, run_log_task: RunLogTask
) -> Iterator[tuple[LogTask, LogTaskSummary]]:
    """Run one log of each of several vehicles at a time; yield each with its outcome as it ends."""
    running: dict[Future[LogTaskSummary], tuple[_Chain, LogTask]] = {}
    waiting = iter(chains)

    def start(chain: _Chain) -> bool:
        request = chain.next()
        if request is None:
            return False
        running[executor.submit(run_log_task, request, limits)] = chain, request
        return True

    while True:
        while len(running) < most and (chain := next(waiting, None)) is not None:
            start(chain)
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            chain, request = running.pop(future)
            summary = future.result()
            chain.take(summary)
            start(chain)
            yield request, summary
