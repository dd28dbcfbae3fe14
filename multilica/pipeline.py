# SPDX-License-Identifier: Apache-2.0
"""The stages of a calibration in their order."""

import time
from collections.abc import Callable, Mapping

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.results import CalibrationResult, Refusal
from multilica.snapshot import Snapshot
from multilica.stages.prior import require_usable
from multilica.steps import clouds, outcome, pairs, rig
from multilica.steps.state import CalibrationState

__all__ = ["calibrate"]


def _all_lidars(state: CalibrationState) -> int:
    return len(state.snapshot.lidars)


def _lidars(state: CalibrationState) -> int:
    return len(state.clouds)


def _pairs(state: CalibrationState) -> int:
    return len(state.pairs)


def _merges(state: CalibrationState) -> int:
    return len(state.clouds) - 1


def _once(_: CalibrationState) -> int:
    return 1


def _nothing(_: CalibrationState) -> None:
    """Do nothing: the snapshot is read before the calibration starts."""


_STEPS: Mapping[Stage, tuple[Callable[[CalibrationState], None], Callable[[CalibrationState], int]]] = {
    "ingest": (_nothing, lambda _: 0),
    "preprocess": (clouds.preprocess_clouds, _all_lidars),
    "features": (clouds.compute_all_features, _lidars),
    "correspond": (pairs.match_pairs, _pairs),
    "coarse": (pairs.find_all_hypotheses, _pairs),
    "verify": (pairs.verify_pairs, _pairs),
    "fine": (pairs.register_pairs, _pairs),
    "merge": (rig.merge_pairs, _merges),
    "refine": (rig.refine_rig, _once),
    "ground": (rig.fit_ground, _once),
}
"""Per stage its function, and the number of LiDARs, pairs or steps that it works on."""


def calibrate(
    snapshot: Snapshot,
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    prior: Extrinsics | None = None,
) -> CalibrationResult:
    """Find where every LiDAR of the snapshot sits relative to the target LiDAR.

    Args:
        snapshot: at least two LiDARs with returns.
        config: the default preset if None.
        observe: called with each event of `multilica.events` as it happens.
        prior: poses that the user claims, by the LiDARs' names: one more hypothesis for each pair that it has,
            verified like the others. The result still has full poses, not corrections to the prior.

    Returns:
        A pose or a reason per LiDAR; a LiDAR that cannot be placed is a normal outcome.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, the target has none, or the vehicle moves.
        UnknownNameError: the snapshot has no LiDAR of the target's name.
        UsageError: the prior lacks two of the LiDARs, or verification is off, so that nothing could check it.
        MissingDependencyError: the configuration asks for an engine that is not installed.
    """
    config = config or CalibrationConfig()
    clouds.require_two_lidars(snapshot)
    if config.target:
        snapshot[config.target]
    if prior is not None:
        require_usable(prior, snapshot, config)
    state = CalibrationState(snapshot, config, observe, prior)
    observe(events.CalibrationStarted(snapshot, config, prior))
    try:
        with threadpool_limits(config.runtime.threads):
            for stage in STAGES[: STAGES.index(config.until) + 1]:
                _run(stage, state)
    except UnfitSnapshotError as error:
        observe(events.CalibrationFinished(outcome.refused(state, Refusal(error.code, str(error)))))
        raise
    result = outcome.result_of(state)
    observe(events.CalibrationFinished(result))
    return result


def _run(stage: Stage, state: CalibrationState) -> None:
    """Run one stage between its two events."""
    run, count = _STEPS[stage]
    state.observe(events.StageStarted(stage, count(state)))
    start = time.perf_counter()
    run(state)
    state.timing_s[stage] = time.perf_counter() - start
    state.observe(events.StageFinished(stage, state.timing_s[stage]))
