# SPDX-License-Identifier: Apache-2.0
"""Figures per stage that `multilica diff` compares."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from multilica.config import Stage
from multilica.results import CoarseResult
from multilica.results.document.stages import (
    CoarseFigures,
    CorrespondFigures,
    FeatureFigures,
    FineFigures,
    GroundFigures,
    IngestFigures,
    MergeFigures,
    PoseFigures,
    PreprocessFigures,
    StageFigures,
    VerifyFigures,
)
from multilica.results.values import Entry
from multilica.sinks.text.log_lines import pair_label

if TYPE_CHECKING:
    from multilica.sinks.run_state import RunState

_DIGEST_CHARACTERS = 16


def stage_figures(state: RunState) -> StageFigures:
    """Return the figures of each finished stage that has any, per LiDAR, pair or step.

    Digests replace arrays that are the same bits in equal runs, with any number of worker processes.
    """
    stages = [stage for stage in state.stages if stage in _FIGURES]
    for stage in stages:
        if stage not in state.figures:
            state.figures[stage] = _FIGURES[stage](state)
    return StageFigures(**{stage: state.figures[stage] for stage in stages})


def _digest(*arrays: npt.NDArray[Any]) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:_DIGEST_CHARACTERS]


def _ingest(state: RunState) -> dict[str, IngestFigures]:
    lidars = state.snapshot.lidars if state.snapshot is not None else ()
    return {
        lidar.name: IngestFigures(
            frames=len(lidar.scans),
            points=lidar.points_count,
            digest=_digest(*(scan.points_m for scan in lidar.scans)),
        )
        for lidar in lidars
    }


def _preprocess(state: RunState) -> dict[str, PreprocessFigures]:
    return {
        name: PreprocessFigures(
            returns=cloud.returns,
            points=len(cloud.points_m),
            dropped={reason: len(points_m) for reason, points_m in sorted(cloud.dropped_m.items())},
            digest=_digest(cloud.points_m),
        )
        for name, cloud in state.clouds.items()
    }


def _features(state: RunState) -> dict[str, FeatureFigures]:
    return {
        name: FeatureFigures(points=len(cloud.points_m), digest=_digest(cloud.points_m, cloud.descriptors))
        for name, cloud in state.features.items()
    }


def _correspond(state: RunState) -> dict[str, CorrespondFigures]:
    return {
        pair_label(*pair): CorrespondFigures(
            matches=len(matches), digest=_digest(matches.target_points_m, matches.source_points_m)
        )
        for pair, matches in state.matches.items()
    }


def _coarse(state: RunState) -> dict[str, CoarseFigures]:
    return {pair_label(*pair): _of_hypotheses(coarse) for pair, coarse in state.coarse.items()}


def _of_hypotheses(coarse: CoarseResult) -> CoarseFigures:
    count = len(coarse.hypotheses)
    if not count:
        return CoarseFigures.of(coarse, hypotheses=0)
    best = coarse.hypotheses[0]
    return CoarseFigures.of(best.T_target_source, best, coarse, hypotheses=count, solver=best.origin)


def _verify(state: RunState) -> dict[str, VerifyFigures]:
    return {
        pair_label(*pair): VerifyFigures.of(
            *((found[0].T_target_source, found[0].visibility, found[0]) if found else ()), distinct=len(found)
        )
        for pair, found in state.verified.items()
    }


def _fine(state: RunState) -> dict[str, FineFigures]:
    return {
        pair_label(*pair): FineFigures.of(found.T_target_source, found, verdict=found.verdict.outcome)
        for pair, found in state.registrations.items()
    }


def _merge(state: RunState) -> dict[str, MergeFigures]:
    return {
        f"step {decision.step}": MergeFigures(
            chosen=None if decision.chosen is None else pair_label(decision.chosen.target, decision.chosen.source),
            fitness=None if decision.chosen is None else decision.chosen.fitness,
            groups="; ".join(" + ".join(group) for group in decision.groups),
        )
        for decision in state.decisions
    }


def _refine(state: RunState) -> dict[str, PoseFigures]:
    return {pose.source: PoseFigures.of(pose) for pose in state.rig}


def _ground(state: RunState) -> dict[str, GroundFigures]:
    plane = None if state.ground is None else state.ground.ground
    return {} if plane is None else {"plane": GroundFigures.of(plane)}


_FIGURES: Mapping[Stage, Callable[[RunState], Mapping[str, Entry]]] = {
    "ingest": _ingest,
    "preprocess": _preprocess,
    "features": _features,
    "correspond": _correspond,
    "coarse": _coarse,
    "verify": _verify,
    "fine": _fine,
    "merge": _merge,
    "refine": _refine,
    "ground": _ground,
}
