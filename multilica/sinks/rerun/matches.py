# SPDX-License-Identifier: Apache-2.0
"""Matches of a pair, drawn as lines to a source cloud lifted above the target."""

import numpy as np
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import BoolArray, Correspondences, Hypothesis
from multilica.sinks.drawing.palette import KEPT, MUTED, REJECTED, Rgb
from multilica.sinks.drawing.shapes import kept_matches, match_lines, shown_radius_m
from multilica.sinks.rerun.entity_paths import lidar_frame, pair_frame, pair_path
from multilica.sinks.rerun.scene import RerunScene, rigid

_LIFT_PER_RADIUS = 0.5


def log_matches(scene: RerunScene, event: events.CorrespondencesMatched) -> None:
    """Log all matches, before the coarse stage keeps or rejects them."""
    matches = event.correspondences
    target, source = matches.target, matches.source
    pose = _lifted(scene, matches, RigidTransform.identity(target, source))
    features = scene.state.features.get(source)
    if features is not None:
        path = pair_path(target, source, "matches", "source")
        frame = pair_frame(target, source, "lifted")
        scene.log_points(path, frame, features.points_m, scene.colour(source), scene.limits.pair_points)
    everything = np.ones(len(matches), dtype=np.bool_)
    _log_lines(scene, matches, "undecided", everything, pose, MUTED)


def log_verdict_on_matches(scene: RerunScene, matches: Correspondences, best: Hypothesis | None) -> None:
    """Log which matches the best hypothesis keeps; without one, all are rejected."""
    identity = RigidTransform.identity(matches.target, matches.source)
    pose = _lifted(scene, matches, best.T_target_source if best else identity)
    kept = kept_matches(scene.state, matches, best) if best else np.zeros(len(matches), dtype=np.bool_)
    _log_lines(scene, matches, "undecided", np.zeros_like(kept), pose, MUTED)
    _log_lines(scene, matches, "rejected", ~kept, pose, REJECTED)
    _log_lines(scene, matches, "kept", kept, pose, KEPT, radius_pixels=1.2)


def lift_m(matches: Correspondences) -> float:
    """Return how far the source is moved along the target's z axis."""
    return _LIFT_PER_RADIUS * shown_radius_m(matches.target_points_m)


def _lifted(scene: RerunScene, matches: Correspondences, pose: RigidTransform) -> RigidTransform:
    """Log and return the pose, moved up the target's z axis."""
    xyz_m = pose.xyz_m + np.array([0.0, 0.0, lift_m(matches)])
    lifted = RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, xyz_m)
    frame = pair_frame(matches.target, matches.source, "lifted")
    path = pair_path(matches.target, matches.source, "matches", "lifted")
    scene.log(path, rigid(frame, lidar_frame(matches.target), lifted))
    return lifted


def _log_lines(
    scene: RerunScene,
    matches: Correspondences,
    kind: str,
    chosen: BoolArray,
    pose: RigidTransform,
    colour: Rgb,
    *,
    radius_pixels: float = 0.25,
) -> None:
    lines = match_lines(matches, chosen, pose, scene.limits.matches).astype(np.float32)
    strips = rr.LineStrips3D(lines, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
    path = pair_path(matches.target, matches.source, "matches", kind)
    scene.log_in(lidar_frame(matches.target), path, strips)
