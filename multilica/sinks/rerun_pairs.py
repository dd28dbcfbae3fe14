# SPDX-License-Identifier: Apache-2.0
"""The poses of a pair, each of which moves the source's cloud."""

from __future__ import annotations

import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Assessment, Hypothesis, PairKey, PairRegistration, hypothesis_label
from multilica.sinks.failures import failures
from multilica.sinks.pair_scores import pair_scores_markdown
from multilica.sinks.rerun_curves import log_curves
from multilica.sinks.rerun_judged import log_judged
from multilica.sinks.rerun_matches import log_verdict_on_matches
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import before_frame, hypothesis_frame, lidar_frame, pair_path
from multilica.sinks.rerun_verdict import log_contested_place, log_verdict
from multilica.sinks.run_story import as_matched

__all__ = ["log_assessments", "log_contested_places", "log_hypotheses", "log_registration", "show_best_poses"]

_AXIS_LENGTH_M = 0.5


def log_hypotheses(scene: Scene, event: events.HypothesesFound) -> None:
    """Every coarse pose of a pair, one step each, the best one last; then the matches that it keeps."""
    pair = (event.coarse.target, event.coarse.source)
    hypotheses = event.coarse.hypotheses
    for index in reversed(range(len(hypotheses))):
        scene.advance()
        scene.shown_at[hypotheses[index]] = scene.step
        start = hypothesis_label(index, hypotheses[index].origin)
        _log_pose(scene, pair, start, hypotheses[index].T_target_source)
    log_verdict_on_matches(scene, event.correspondences, hypotheses[0] if hypotheses else None)
    _log_scores(scene, pair, hypotheses[0] if hypotheses else None)


def log_assessments(scene: Scene, event: events.HypothesesAssessed) -> None:
    """Every distinct pose with the points that were judged, one step each, the best one last."""
    pair = (event.target, event.source)
    for assessment in reversed(event.assessments):
        _show_judged(scene, pair, assessment)


def log_registration(scene: Scene, event: events.PairRegistered) -> None:
    """GICP's progress, the finalists as they were judged in the end, then the pose with its verdict.

    A pair whose verdict is told anew has its progress and its finalists in the recording. Of merged clouds, and of
    loops that did not close, only progress and pose are told.
    """
    registration = event.registration
    pair, start = scene.story.pair_of(registration), _start(scene, registration)
    anew = any(assessment in scene.shown_at for assessment in registration.assessments)
    if not anew:
        log_curves(scene, registration, start)
    kept = scene.story.registrations.get(pair) is registration
    if kept and not anew:
        for assessment in reversed(registration.assessments):
            _show_judged(scene, pair, assessment)
    _log_pose(scene, pair, start, as_matched(pair, registration.T_target_source))
    if kept:
        _log_before(scene, pair, registration)
        log_verdict(scene, pair, start, registration)
        _log_scores(scene, pair, registration.assessments[0] if registration.assessments else None)


def log_contested_places(scene: Scene) -> None:
    """At the end: of each LiDAR that two accepted pairs put at different places, both."""
    for failure in failures(scene.story):
        if failure.pair is not None and failure.elsewhere is not None:
            found = scene.story.registrations[failure.pair]
            log_contested_place(scene, failure, failure.pair, _start(scene, found), found)


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
    if cloud is not None and path not in scene.shown:
        scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points)
    else:
        scene.log(path, rr.CoordinateFrame(frame))


def _show_judged(scene: Scene, pair: PairKey, assessment: Assessment) -> None:
    scene.advance()
    scene.shown_at[assessment] = scene.step
    _log_pose(scene, pair, assessment.label, as_matched(pair, assessment.T_target_source))
    log_judged(scene, pair, assessment.label, assessment)
    _log_scores(scene, pair, assessment)


def _log_before(scene: Scene, pair: PairKey, registration: PairRegistration) -> None:
    """The source where the coarse stage had put it: what GICP started from."""
    target, source = pair
    coarse, cloud = scene.story.coarse.get(pair), scene.story.clouds.get(source)
    if coarse is None or cloud is None or not 0 <= registration.hypothesis < len(coarse.hypotheses):
        return
    frame, path = before_frame(target, source), pair_path(target, source, "before")
    pose = coarse.hypotheses[registration.hypothesis].T_target_source
    scene.log(pair_path(target, source, "before", "pose"), rigid(frame, lidar_frame(target), pose))
    scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points // 3)


def _log_scores(scene: Scene, pair: PairKey, shown: Hypothesis | Assessment | None) -> None:
    text = pair_scores_markdown(scene.story, pair, shown, scene.shown_at)
    scene.log_document(pair_path(*pair, "scores"), text)
