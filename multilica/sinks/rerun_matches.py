# SPDX-License-Identifier: Apache-2.0
"""The matches of a pair as lines between two clouds, one lifted above the other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import BoolArray, Correspondences, Hypothesis
from multilica.sinks.kept_matches import kept_matches
from multilica.sinks.palette import KEPT, MUTED, REJECTED, Rgb
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import lidar_frame, lifted_frame, pair_path
from multilica.sinks.slots import shown_radius_m
from multilica.sinks.thinning import sample_indices

__all__ = ["log_matches", "log_verdict_on_matches"]

_LIFT_PER_RADIUS = 0.5


def log_matches(scene: Scene, event: events.CorrespondencesMatched) -> None:
    """All matches, before anything is known of which are right."""
    matches = event.correspondences
    target, source = matches.target, matches.source
    features = scene.story.features.get(source)
    if features is not None:
        path = pair_path(target, source, "matches", "source")
        frame = lifted_frame(target, source)
        scene.log_points(path, frame, features.points_m, scene.colour(source), scene.limits.pair_points)
    pose = _lifted(scene, matches, RigidTransform.identity(target, source))
    everything = np.ones(len(matches), dtype=np.bool_)
    _log_lines(scene, matches, "undecided", everything, pose, MUTED)


def log_verdict_on_matches(scene: Scene, matches: Correspondences, best: Hypothesis | None) -> None:
    """Which matches the best hypothesis keeps; all are rejected if there is none."""
    identity = RigidTransform.identity(matches.target, matches.source)
    pose = _lifted(scene, matches, best.T_target_source if best else identity)
    kept = kept_matches(scene.story, matches, best) if best else np.zeros(len(matches), dtype=np.bool_)
    _log_lines(scene, matches, "undecided", np.zeros_like(kept), pose, MUTED)
    _log_lines(scene, matches, "rejected", ~kept, pose, REJECTED)
    _log_lines(scene, matches, "kept", kept, pose, KEPT, radius_pixels=1.2)


def _lifted(scene: Scene, matches: Correspondences, pose: RigidTransform) -> RigidTransform:
    """The pose, moved up the target's z axis; logged as the frame of the lifted cloud."""
    radius_m = shown_radius_m(matches.target_points_m)
    xyz_m = pose.xyz_m + np.array([0.0, 0.0, _LIFT_PER_RADIUS * radius_m])
    lifted = RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, xyz_m)
    frame = lifted_frame(matches.target, matches.source)
    path = pair_path(matches.target, matches.source, "matches", "lifted")
    scene.log(path, rigid(frame, lidar_frame(matches.target), lifted))
    return lifted


def _log_lines(
    scene: Scene,
    matches: Correspondences,
    kind: str,
    chosen: BoolArray,
    pose: RigidTransform,
    colour: Rgb,
    *,
    radius_pixels: float = 0.25,
) -> None:
    rows = np.flatnonzero(chosen)
    lines = _segments(matches, rows[sample_indices(len(rows), scene.limits.matches)], pose)
    strips = rr.LineStrips3D(lines, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
    path = pair_path(matches.target, matches.source, "matches", kind)
    scene.log(path, rr.CoordinateFrame(lidar_frame(matches.target)), strips)


def _segments(matches: Correspondences, rows: npt.NDArray[np.int64], pose: RigidTransform) -> npt.NDArray[np.float32]:
    """(K, 2, 3) from the target's point to the source's in the lifted frame."""
    ends = (matches.target_points_m[rows], pose.apply(matches.source_points_m[rows]))
    return np.stack(ends, axis=1).astype(np.float32)
