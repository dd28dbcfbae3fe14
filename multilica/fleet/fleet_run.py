# SPDX-License-Identifier: Apache-2.0
"""A run over the logs of a fleet."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import partial

from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.documents import local_path
from multilica.errors import SourceNotFoundError, listed
from multilica.fleet.listing import FleetLog, find_logs
from multilica.fleet.patterns import LogPattern
from multilica.fleet.plan import Plan, QueuedLog, full_disk_named
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import Store
from multilica.fleet.tasks.guard import Calibrate, LogTask, LogTaskLimits, identify_guarded, open_executor, run_guarded
from multilica.fleet.vehicle_chain import VehicleChain
from multilica.ingest.remote.address import scheme_of, without_secrets
from multilica.scratch import scratch_folder

# Tasks that wait at the executor for each that runs, so that none waits for the driver.
_AHEAD = 2
# Settings that change no result.
_INDIFFERENT = {"runtime": {"workers"}, "record": {"detail", "max_megabytes"}}
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

    The logs of a vehicle are decided one after the other, by time, as each is verified against the poses that the last
    accepted calibration before it gave; vehicles run beside each other. Workers without a vehicle treat logs ahead.
    So the rows depend neither on the number of workers nor on interruptions.

    Args:
        logs: as `find_logs` takes them.
        run_log_task: run in a thread of this process or of a Dask worker.

    Raises:
        MultilicaError: as `find_logs` and `open_executor`.
        SourceNotFoundError: no log is found.
        StorageError: the store or a disk is full or refuses. The log at hand has no row, so the next run goes on.
    """
    outcome, digest = FleetOutcome(), _config_digest(options)
    with (
        scratch_folder() as folder,
        full_disk_named(),
        open_executor(options.workers, options.scheduler) as (executor, slots),
        closing(Plan(folder, store, digest, options.limits, newest_first=options.newest_first)) as plan,
    ):
        plan.add(find_logs(logs, options.pattern, outcome.count_unlike))
        plan.settle(lambda addresses: executor.map(partial(identify_guarded, limits=options.limits), addresses))
        outcome.found, to_do = plan.counts()
        if not outcome.found:
            given = [without_secrets(each) if scheme_of(each) else each for each in logs]
            raise SourceNotFoundError(
                f"No log was found in {listed(given)}; expected recordings, folders with point files, or a manifest."
            )
        outcome.skipped = outcome.found - to_do
        observe(outcome)
        make = partial(_task, store=store, options=options, config_sha256=digest)
        chains = (VehicleChain(plan.logs_of(vehicle), store, make) for vehicle in plan.vehicles())
        for row in _run_chains(chains, lambda task: executor.submit(run_log_task, task, options.limits), slots):
            outcome.states[row.state] = outcome.states.get(row.state, 0) + 1
            observe(row)
    return outcome


def _config_digest(options: FleetOptions) -> str:
    """Return the hash of all settings that a result depends on."""
    values = options.config.model_dump(mode="json", exclude=_INDIFFERENT)
    settings = [values, options.tolerances.model_dump(mode="json"), options.calibrate]
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def _task(log: QueuedLog, reference: str, *, store: Store, options: FleetOptions, config_sha256: str) -> LogTask:
    return LogTask(
        **{name: value for name, value in asdict(log).items() if name not in ("finished", "accepted")},
        store=store.address if scheme_of(store.address) else str(local_path(store.address).absolute()),
        config=options.config,
        config_sha256=config_sha256,
        tolerances=options.tolerances,
        calibrate=options.calibrate,
        reference=reference,
    )


def _run_chains(
    chains: Iterator[VehicleChain], submit: Callable[[LogTask], Future[LogRow]], slots: int
) -> Iterator[LogRow]:
    """Run one log of each of several vehicles at a time, and logs ahead where that leaves workers free."""
    running: dict[Future[LogRow], VehicleChain] = {}
    opened: list[VehicleChain] = []

    def start(chain: VehicleChain, task: LogTask | None) -> None:
        if task is not None:
            running[chain.add(task, submit(task))] = chain

    while True:
        while len(running) < _AHEAD * slots and (chain := next(chains, None)) is not None:
            opened.append(chain)
            start(chain, chain.next_task())
        while len(running) < slots and (ready := [chain for chain in opened if chain.may_go_ahead(_AHEAD * slots)]):
            chain = min(ready, key=len)
            start(chain, chain.next_task())
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            chain = running.pop(future)
            yield from chain.decide()
            start(chain, chain.next_task() if not len(chain) else chain.task_again())
        opened = [chain for chain in opened if len(chain)]
