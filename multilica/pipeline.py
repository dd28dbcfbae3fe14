# SPDX-License-Identifier: Apache-2.0
"""The stages of a calibration in their order."""

import time
from collections.abc import Callable
from contextlib import nullcontext

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage, require_ranges
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.orchestration import clouds, open_calibration_workers
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.orchestration.pairs import PAIR_STAGES, PreparedLidar
from multilica.orchestration.refinement import estimate_sigmas, refine_rig
from multilica.orchestration.rig import compare_surfaces, fit_ground, merge_pairs, refused, result_of
from multilica.orchestration.search import search_pairs
from multilica.orchestration.state import CalibrationState, deadline_of
from multilica.results import CalibrationResult, Refusal
from multilica.snapshot import Snapshot
from multilica.stages.known_poses import require_free_base, require_usable_prior, require_usable_rig
from multilica.workers import Workers

_STEPS: tuple[tuple[tuple[Stage, ...], Callable[[CalibrationState, Stage], None]], ...] = (
    (("preprocess",), lambda state, _: clouds.preprocess_clouds(state)),
    (("features",), lambda state, _: clouds.prepare_lidars(state)),
    (PAIR_STAGES, search_pairs),
    (("merge",), lambda state, _: _merge(state)),
    (("refine",), lambda state, _: _refine(state)),
    (("ground",), lambda state, _: fit_ground(state)),
)
"""The stages that are run together, with their function, which gets the last of them to run.

A pair goes through all of its stages before the next pairs are chosen.
"""


def calibrate(
    snapshot: Snapshot,
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    prior: Extrinsics | None = None,
    workers: Workers | None = None,
    rig: Extrinsics | None = None,
    deadline_s: float | None = None,
    prepared: dict[str, PreparedLidar] | None = None,
    earlier: EarlierStops | None = None,
) -> CalibrationResult:
    """Find the pose of every LiDAR of the snapshot relative to the target LiDAR, like `multilica.calibrate`.

    Args:
        prior: one more hypothesis for each pair that it has, verified like the others. The result still has full poses,
            not corrections to the prior.
        rig: has the target in the base frame, by name or frame id.
        deadline_s: on `time.monotonic`, after which no pair is searched; by default `runtime.max_time_s` from now.
        prepared: receives the prepared LiDARs, for links to other stops.
        earlier: stops of the same drive, whose poses are tested before anything is searched.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, the target has none, or the vehicle moves.
        UnknownNameError: the snapshot has no LiDAR of the target's name.
        UsageError: a LiDAR has the name of the base frame; the prior lacks two of the LiDARs, or verification is off,
            so that nothing could check it; the rig lacks the base frame or a LiDAR that may become the target.
    """
    config = config or CalibrationConfig()
    clouds.require_libraries(config)
    require_ranges(config)
    clouds.require_two_lidars(snapshot)
    if config.target:
        snapshot[config.target]
    require_free_base(snapshot, config)
    if prior is not None:
        require_usable_prior(prior, snapshot, config)
    if rig is not None:
        require_usable_rig(rig, snapshot, config)
    deadline_s = deadline_of(config) if deadline_s is None else deadline_s
    state = CalibrationState(
        snapshot, config, observe, prior, rig=rig, earlier=earlier or EarlierStops(), deadline_s=deadline_s
    )
    observe(events.CalibrationStarted(snapshot, config, prior))
    if workers is not None:
        workers.forget()
    opened = open_calibration_workers(config) if workers is None else nullcontext(workers)
    try:
        with threadpool_limits(1), opened as state.workers:
            _run_stages(state)
            result = result_of(state)
            state.workers.forget()
            if prepared is not None:
                prepared.update(state.lidars)
    except UnfitSnapshotError as error:
        observe(events.CalibrationFinished(refused(state, Refusal(error.code, str(error)))))
        raise
    del state  # prepared LiDARs take most of the memory, and the sinks need some for the last files
    observe(events.CalibrationFinished(result))
    return result


def _run_stages(state: CalibrationState) -> None:
    """Run the stages as far as the configuration says, each between its two events."""
    wanted = STAGES[: STAGES.index(state.config.until) + 1]
    state.timing_s["ingest"] = state.snapshot.reading_s  # it ended when the snapshot was read
    state.observe(events.StageStarted("ingest", 0))
    state.observe(events.StageFinished("ingest", state.snapshot.reading_s))
    for stages, run in _STEPS:
        due = [stage for stage in stages if stage in wanted]
        if not due:
            return
        steps = _steps_of(due[0], state)
        for stage in due:
            state.observe(events.StageStarted(stage, steps))
        start_s = time.perf_counter()
        run(state, due[-1])
        if len(stages) == 1:
            state.timing_s[due[0]] = time.perf_counter() - start_s
        for stage in due:
            state.observe(events.StageFinished(stage, state.timing_s.setdefault(stage, 0.0)))


def _merge(state: CalibrationState) -> None:
    merge_pairs(state)
    if state.config.until == "merge" or not state.config.refine.enabled:
        estimate_sigmas(state)


def _refine(state: CalibrationState) -> None:
    refine_rig(state)
    compare_surfaces(state)


def _steps_of(stage: Stage, state: CalibrationState) -> int:
    """Return the number of events to come, 0 if unknown."""
    if stage in PAIR_STAGES:
        return 0
    counts = {"preprocess": len(state.snapshot.lidars), "features": len(state.clouds), "merge": len(state.clouds) - 1}
    return counts.get(stage, 1)
