# SPDX-License-Identifier: Apache-2.0
"""A few figures per stage, by which two runs can be told apart."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.config import Stage
from multilica.geometry import RigidTransform
from multilica.sinks.narration import pair_label
from multilica.sinks.run_story import RunStory

__all__ = ["Figures", "stage_figures"]

Figures = Mapping[str, Mapping[str, Any]]
_DIGEST_CHARACTERS = 16


def stage_figures(story: RunStory) -> dict[str, Figures]:
    """Per finished stage, per LiDAR, pair or step, what came out of it.

    Digests stand for arrays that equal runs have bit for bit whatever the number of threads; all else are figures.
    """
    for stage in story.stages:
        if stage not in story.figures:
            story.figures[stage] = _FIGURES[stage](story)
    return {stage: story.figures[stage] for stage in story.stages}


def _digest(*arrays: npt.NDArray[Any]) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:_DIGEST_CHARACTERS]


def _pose(pose: RigidTransform) -> dict[str, Any]:
    return {"xyz_m": pose.xyz_m, "rpy_deg": pose.rpy_deg}


def _ingest(story: RunStory) -> Figures:
    lidars = story.snapshot.lidars if story.snapshot is not None else ()
    return {
        lidar.name: {
            "frames": len(lidar.scans),
            "points": lidar.points_count,
            "digest": _digest(*(scan.points_m for scan in lidar.scans)),
        }
        for lidar in lidars
    }


def _preprocess(story: RunStory) -> Figures:
    return {
        name: {
            "returns": len(cloud.returns_m),
            "points": len(cloud.points_m),
            **{f"dropped_{reason}": len(points_m) for reason, points_m in sorted(cloud.dropped_m.items())},
            "digest": _digest(cloud.points_m),
        }
        for name, cloud in story.clouds.items()
    }


def _features(story: RunStory) -> Figures:
    return {
        name: {"points": len(cloud.points_m), "digest": _digest(cloud.points_m, cloud.descriptors)}
        for name, cloud in story.features.items()
    }


def _correspond(story: RunStory) -> Figures:
    return {
        pair_label(*pair): {
            "matches": len(matches),
            "digest": _digest(matches.target_points_m, matches.source_points_m),
        }
        for pair, matches in story.matches.items()
    }


def _coarse(story: RunStory) -> Figures:
    return {
        pair_label(*pair): {
            "hypotheses": len(coarse.hypotheses),
            "graph_nodes": coarse.graph_nodes,
            "graph_edges": coarse.graph_edges,
            **({"score": coarse.hypotheses[0].score} if coarse.hypotheses else {}),
            **(_pose(coarse.hypotheses[0].T_target_source) if coarse.hypotheses else {}),
        }
        for pair, coarse in story.coarse.items()
    }


def _verify(story: RunStory) -> Figures:
    return {
        pair_label(*pair): {
            "distinct": len(found),
            **({"agree": found[0].testimony.agree, "violate": found[0].testimony.violate} if found else {}),
            **({"evidence": found[0].evidence, **_pose(found[0].T_target_source)} if found else {}),
        }
        for pair, found in story.assessments.items()
    }


def _fine(story: RunStory) -> Figures:
    return {
        pair_label(*pair): {
            "verdict": found.verdict.outcome,
            "fitness": found.fitness,
            "rmse_m": found.rmse_m,
            **_pose(found.T_target_source),
        }
        for pair, found in story.registrations.items()
    }


def _merge(story: RunStory) -> Figures:
    return {
        f"step {decision.step}": {
            "chosen": None if decision.chosen is None else pair_label(decision.chosen.target, decision.chosen.source),
            "fitness": None if decision.chosen is None else decision.chosen.fitness,
            "groups": "; ".join(" + ".join(group) for group in decision.groups),
        }
        for decision in story.decisions
    }


def _refine(story: RunStory) -> Figures:
    return {pose.source: _pose(pose) for pose in story.rig}


def _ground(story: RunStory) -> Figures:
    if story.ground is None or story.ground.ground is None:
        return {}
    return {"plane": {"offset_m": story.ground.ground.offset_m, "normal": story.ground.ground.normal}}


_FIGURES: Mapping[Stage, Callable[[RunStory], Figures]] = {
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
