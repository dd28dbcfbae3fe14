# SPDX-License-Identifier: Apache-2.0
"""Poses of a pair, each of which moves the source's cloud."""

import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Hypothesis, PairKey, PairRegistration, Registration, hypothesis_label
from multilica.sinks.failures import failures
from multilica.sinks.rerun.curves import log_curves
from multilica.sinks.rerun.matches import log_verdict_on_matches
from multilica.sinks.rerun.scene import RerunScene, rigid
from multilica.sinks.rerun.scored_points import log_scored_points
from multilica.sinks.rerun.tree import lidar_frame, pair_frame, pair_path
from multilica.sinks.rerun.verdict import log_contested_place, log_verdict
from multilica.sinks.text.pair_scores import pair_scores_markdown

__all__ = [
    "log_changed_verdict",
    "log_contested_places",
    "log_group_registration",
    "log_hypotheses",
    "log_loop",
    "log_registration",
    "log_verified",
    "show_best_poses",
]

_AXIS_LENGTH_M = 0.5


def log_hypotheses(scene: RerunScene, event: events.HypothesesFound) -> None:
    """Log every hypothesis of a pair, one step each, the best last; then the matches that it keeps."""
    pair = (event.coarse.target, event.coarse.source)
    hypotheses = event.coarse.hypotheses
    for index in reversed(range(len(hypotheses))):
        scene.advance()
        scene.shown_at[hypotheses[index]] = scene.step
        start = hypothesis_label(index, hypotheses[index].origin)
        _log_pose(scene, pair, start, hypotheses[index].T_target_source)
    log_verdict_on_matches(scene, event.correspondences, hypotheses[0] if hypotheses else None)
    _log_scores(scene, pair, hypotheses[0] if hypotheses else None)


def log_verified(scene: RerunScene, event: events.HypothesesVerified) -> None:
    """Log every distinct hypothesis with its scored points, one step each, the best last."""
    pair = (event.target, event.source)
    for scored in reversed(event.registrations):
        _show_scored(scene, pair, scored)


def log_registration(scene: RerunScene, event: events.PairRegistered) -> None:
    """Log GICP's progress, the scored poses, then the registered pose with its verdict."""
    registration = event.registration
    pair, start = scene.state.pair_of(registration), registration.start_label
    log_curves(scene, registration, start)
    for scored in reversed(registration.registrations):
        _show_scored(scene, pair, scored)
    _log_with_verdict(scene, pair, start, registration)


def log_changed_verdict(scene: RerunScene, event: events.VerdictChanged) -> None:
    """Log the pose of a registration with its new verdict."""
    registration = event.registration
    _log_with_verdict(scene, scene.state.pair_of(registration), registration.start_label, registration)


def log_group_registration(scene: RerunScene, event: events.GroupsRegistered) -> None:
    """Log GICP's progress and the pose of two groups, between their roots."""
    start = f"merged-{len(scene.state.group_registrations)}"
    _log_progress(scene, start, event.registration)


def log_loop(scene: RerunScene, event: events.LoopRegistered) -> None:
    """Log a loop as a registration of its pair if it was accepted, else only GICP's progress and the pose."""
    if event.registration.verdict.accepted:
        log_registration(scene, events.PairRegistered(event.registration))
    else:
        _log_progress(scene, event.registration.start_label, event.registration)


def _log_progress(scene: RerunScene, start: str, registration: PairRegistration) -> None:
    pair = scene.state.pair_of(registration)
    log_curves(scene, registration, start)
    _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))


def _log_with_verdict(scene: RerunScene, pair: PairKey, start: str, registration: PairRegistration) -> None:
    _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))
    _log_before(scene, pair, registration)
    log_verdict(scene, pair, start, registration)
    _log_scores(scene, pair, registration.registrations[0] if registration.registrations else None)


def log_contested_places(scene: RerunScene) -> None:
    """Log both places of each LiDAR that two accepted pairs put at different places."""
    for failure in failures(scene.state):
        if failure.pair is not None and failure.elsewhere is not None:
            found = scene.state.registrations[failure.pair]
            log_contested_place(scene, failure, failure.pair, found.start_label)


def show_best_poses(scene: RerunScene) -> None:
    """Move each pair's source cloud to its best pose."""
    for pair in scene.state.pairs:
        start = _best_start(scene, pair)
        if start is not None:
            _show_at(scene, pair, start)


def _best_start(scene: RerunScene, pair: PairKey) -> str | None:
    state = scene.state
    if pair in state.registrations:
        return state.registrations[pair].start_label
    if state.verified.get(pair):
        return state.verified[pair][0].label
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    return hypothesis_label(0, hypotheses[0].origin) if hypotheses else None


def _log_pose(scene: RerunScene, pair: PairKey, start: str, T_target_source: RigidTransform) -> None:
    target, source = pair
    pose = rigid(pair_frame(target, source, start), lidar_frame(target), T_target_source)
    scene.log(pair_path(target, source, "poses", start), pose, rr.TransformAxes3D(_AXIS_LENGTH_M))
    _show_at(scene, pair, start)


def _show_at(scene: RerunScene, pair: PairKey, start: str) -> None:
    """Move the source's cloud into that pose's frame; log its points with the first pose."""
    target, source = pair
    cloud = scene.state.clouds.get(source)
    path, frame = pair_path(target, source, "source"), pair_frame(target, source, start)
    if cloud is not None and path not in scene.shown:
        scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points)
    else:
        scene.log(path, rr.CoordinateFrame(frame))


def _show_scored(scene: RerunScene, pair: PairKey, scored: Registration) -> None:
    scene.advance()
    scene.shown_at[scored] = scene.step
    _log_pose(scene, pair, scored.label, scored.T_target_source.with_target(pair[0]))
    log_scored_points(scene, pair, scored.label, scored)
    _log_scores(scene, pair, scored)


def _log_before(scene: RerunScene, pair: PairKey, registration: PairRegistration) -> None:
    """Log the source at the hypothesis from which GICP started."""
    target, source = pair
    coarse, cloud = scene.state.coarse.get(pair), scene.state.clouds.get(source)
    if coarse is None or cloud is None or not 0 <= registration.hypothesis < len(coarse.hypotheses):
        return
    frame, path = pair_frame(target, source, "before"), pair_path(target, source, "before")
    pose = coarse.hypotheses[registration.hypothesis].T_target_source
    scene.log(pair_path(target, source, "before", "pose"), rigid(frame, lidar_frame(target), pose))
    scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points // 3)


def _log_scores(scene: RerunScene, pair: PairKey, shown: Hypothesis | Registration | None) -> None:
    text = pair_scores_markdown(scene.state, pair, shown, scene.shown_at)
    scene.log_document(pair_path(*pair, "scores"), text)
