# SPDX-License-Identifier: Apache-2.0
"""Figures per stage that `multilica diff` compares."""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.config import Stage
from multilica.geometry import RigidTransform
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
from multilica.results.document.values import Entry
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label

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


def _pose(pose: RigidTransform) -> dict[str, Any]:
    return {"xyz_m": pose.xyz_m, "rpy_deg": pose.rpy_deg}


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
    return {
        pair_label(*pair): CoarseFigures(
            hypotheses=len(coarse.hypotheses),
            graph_nodes=coarse.graph_nodes,
            graph_edges=coarse.graph_edges,
            clique_size=coarse.clique_size,
            **({"score": coarse.hypotheses[0].score} if coarse.hypotheses else {}),
            **({"solver": coarse.hypotheses[0].origin} if coarse.hypotheses else {}),
            **(_pose(coarse.hypotheses[0].T_target_source) if coarse.hypotheses else {}),
        )
        for pair, coarse in state.coarse.items()
    }


def _verify(state: RunState) -> dict[str, VerifyFigures]:
    return {
        pair_label(*pair): VerifyFigures(
            distinct=len(found),
            **({"agree": found[0].visibility.agree, "violate": found[0].visibility.violate} if found else {}),
            **({"evidence": found[0].evidence, **_pose(found[0].T_target_source)} if found else {}),
        )
        for pair, found in state.verified.items()
    }


def _fine(state: RunState) -> dict[str, FineFigures]:
    return {
        pair_label(*pair): FineFigures(
            verdict=found.verdict.outcome,
            fitness=found.fitness,
            rmse_m=found.rmse_m,
            **_pose(found.T_target_source),
        )
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
    return {pose.source: PoseFigures(**_pose(pose)) for pose in state.rig}


def _ground(state: RunState) -> dict[str, GroundFigures]:
    if state.ground is None or state.ground.ground is None:
        return {}
    plane = state.ground.ground
    return {"plane": GroundFigures(offset_m=plane.offset_m, normal=plane.normal)}


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
