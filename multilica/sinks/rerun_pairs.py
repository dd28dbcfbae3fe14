# SPDX-License-Identifier: Apache-2.0
"""The poses of a pair, each of which moves the source's cloud."""

from __future__ import annotations

import numpy as np
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairKey, PairRegistration, hypothesis_label
from multilica.sinks.palette import AGREE, OCCLUDED, VIOLATE, Rgb
from multilica.sinks.rerun_curves import log_curves
from multilica.sinks.rerun_matches import log_verdict_on_matches
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import hypothesis_frame, lidar_frame, pair_path
from multilica.stages.beam_image import BeamLabel

__all__ = ["log_assessments", "log_hypotheses", "log_registration", "show_best_poses"]

_MAX_SOURCE_POINTS = 30_000
_MAX_SHOWN_ASSESSMENTS = 4
_AXIS_LENGTH_M = 0.5
_JUDGED: dict[BeamLabel, tuple[str, Rgb]] = {
    BeamLabel.AGREE: ("agree", AGREE),
    BeamLabel.VIOLATE: ("violate", VIOLATE),
    BeamLabel.OCCLUDED: ("occluded", OCCLUDED),
}


def log_hypotheses(scene: Scene, event: events.HypothesesFound) -> None:
    """Every coarse pose of a pair, one step each, the best one last; then the matches that it keeps."""
    pair = (event.coarse.target, event.coarse.source)
    hypotheses = event.coarse.hypotheses
    for index in reversed(range(len(hypotheses))):
        scene.advance()
        start = hypothesis_label(index, hypotheses[index].origin)
        _log_pose(scene, pair, start, hypotheses[index].T_target_source)
    log_verdict_on_matches(scene, event.correspondences, hypotheses[0] if hypotheses else None)


def log_assessments(scene: Scene, event: events.HypothesesAssessed) -> None:
    """The most believable poses with the points that were judged, one step each, the best one last."""
    pair = (event.target, event.source)
    for assessment in reversed(event.assessments[:_MAX_SHOWN_ASSESSMENTS]):
        scene.advance()
        _log_pose(scene, pair, assessment.label, assessment.T_target_source)
        _log_judged_points(scene, pair, assessment)


def log_registration(scene: Scene, event: events.PairRegistered) -> None:
    """GICP's progress, then the pose that it ended with."""
    registration = event.registration
    pair, start = scene.story.pair_of(registration), _start(scene, registration)
    log_curves(scene, registration, start)
    found = registration.T_target_source
    _log_pose(scene, pair, start, found if registration.target == pair[0] else found.inverse())


def show_best_poses(scene: Scene) -> None:
    """Put each pair's source cloud where the best of its poses has it."""
    for pair in scene.story.pairs:
        start = _best_start(scene, pair)
        if start is not None:
            _show_at(scene, pair, start)


def _best_start(scene: Scene, pair: PairKey) -> str | None:
    story = scene.story
    if pair in story.registrations:
        return story.registrations[pair].start_label
    if story.assessments.get(pair):
        return story.assessments[pair][0].label
    hypotheses = story.coarse[pair].hypotheses if pair in story.coarse else ()
    return hypothesis_label(0, hypotheses[0].origin) if hypotheses else None


def _start(scene: Scene, registration: PairRegistration) -> str:
    """The hypothesis that it started from; in the merge stage the how manieth registration of merged clouds it is."""
    merged = len(scene.story.merged_registrations)
    return f"merged-{merged}" if scene.story.stage == "merge" else registration.start_label


def _log_pose(scene: Scene, pair: PairKey, start: str, T_target_source: RigidTransform) -> None:
    target, source = pair
    pose = rigid(hypothesis_frame(target, source, start), lidar_frame(target), T_target_source)
    scene.log(pair_path(target, source, "poses", start), pose, rr.TransformAxes3D(_AXIS_LENGTH_M))
    _show_at(scene, pair, start)


def _show_at(scene: Scene, pair: PairKey, start: str) -> None:
    """Move the source's cloud into that pose's frame; its points are logged once, with the first pose."""
    target, source = pair
    cloud = scene.story.clouds.get(source)
    path, frame = pair_path(target, source, "source"), hypothesis_frame(target, source, start)
    if cloud is not None and pair not in scene.shown_sources:
        scene.shown_sources.add(pair)
        scene.log_points(path, frame, cloud.points_m, scene.colour(source), limit=_MAX_SOURCE_POINTS)
    else:
        scene.log(path, rr.CoordinateFrame(frame))


def _log_judged_points(scene: Scene, pair: PairKey, assessment: Assessment) -> None:
    target, source = pair
    frame = hypothesis_frame(target, source, assessment.label)
    for label, (name, colour) in _JUDGED.items():
        points_m = np.asarray(assessment.probes_m[assessment.testimony.labels == label], dtype=np.float32)
        scene.log_points(pair_path(target, source, "judged", name), frame, points_m, colour, radius_pixels=2.5)
