# SPDX-License-Identifier: Apache-2.0
"""Figures per stage that `multilica diff` compares."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from multilica.config import Stage
from multilica.results import CoarseResult, MergeDecision, Registration
from multilica.results.document import stages as figures
from multilica.results.values import Entry
from multilica.sinks.text.log_lines import pair_label

if TYPE_CHECKING:
    from multilica.sinks.run_state import RunState

_DIGEST_CHARACTERS = 16


def stage_figures(state: RunState) -> figures.StageFigures:
    """Return the figures of each finished stage that has any, per LiDAR, pair or step.

    Digests replace arrays that are the same bits in equal runs, with any number of worker processes.
    """
    stages = [stage for stage in state.stages if stage in _FIGURES]
    for stage in stages:
        if stage not in state.figures:
            state.figures[stage] = _FIGURES[stage](state)
    return figures.StageFigures(**{stage: state.figures[stage] for stage in stages})


def _digest(*arrays: npt.NDArray[Any]) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:_DIGEST_CHARACTERS]


def _coarse(coarse: CoarseResult) -> figures.CoarseFigures:
    best = coarse.hypotheses[:1]
    known = [part for one in best for part in (one.T_target_source, one)]
    solver = {"solver": best[0].origin} if best else {}
    return figures.CoarseFigures.of(*known, coarse, hypotheses=len(coarse.hypotheses), **solver)


def _verify(found: tuple[Registration, ...]) -> figures.VerifyFigures:
    best = [part for one in found[:1] for part in (one.T_target_source, one.visibility, one)]
    return figures.VerifyFigures.of(*best, distinct=len(found))


def _merge(decision: MergeDecision) -> figures.MergeFigures:
    chosen, groups = decision.chosen, "; ".join(" + ".join(group) for group in decision.groups)
    if chosen is None:
        return figures.MergeFigures(chosen=None, fitness=None, groups=groups)
    return figures.MergeFigures(chosen=pair_label(chosen.target, chosen.source), fitness=chosen.fitness, groups=groups)


_FIGURES: Mapping[Stage, Callable[[RunState], Mapping[str, Entry]]] = {
    "ingest": lambda state: {
        lidar.name: figures.IngestFigures(
            frames=len(lidar.scans), points=lidar.points_count, digest=_digest(*(scan.points_m for scan in lidar.scans))
        )
        for lidar in (state.snapshot.lidars if state.snapshot is not None else ())
    },
    "preprocess": lambda state: {
        name: figures.PreprocessFigures(
            returns=cloud.returns,
            points=len(cloud.points_m),
            dropped={reason: len(points_m) for reason, points_m in sorted(cloud.dropped_m.items())},
            digest=_digest(cloud.points_m),
        )
        for name, cloud in state.clouds.items()
    },
    "features": lambda state: {
        name: figures.FeatureFigures(points=len(cloud.points_m), digest=_digest(cloud.points_m, cloud.descriptors))
        for name, cloud in state.features.items()
    },
    "correspond": lambda state: {
        pair_label(*pair): figures.CorrespondFigures(
            matches=len(matches), digest=_digest(matches.target_points_m, matches.source_points_m)
        )
        for pair, matches in state.matches.items()
    },
    "coarse": lambda state: {pair_label(*pair): _coarse(coarse) for pair, coarse in state.coarse.items()},
    "verify": lambda state: {pair_label(*pair): _verify(found) for pair, found in state.verified.items()},
    "fine": lambda state: {
        pair_label(*pair): figures.FineFigures.of(found.T_target_source, found, verdict=found.verdict.outcome)
        for pair, found in state.registrations.items()
    },
    "merge": lambda state: {f"step {decision.step}": _merge(decision) for decision in state.decisions},
    "refine": lambda state: {pose.source: figures.PoseFigures.of(pose) for pose in state.rig},
    "ground": lambda state: (
        {}
        if state.ground is None or state.ground.ground is None
        else {"plane": figures.GroundFigures.of(state.ground.ground)}
    ),
}
