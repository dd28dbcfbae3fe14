# SPDX-License-Identifier: Apache-2.0
"""Poses of a pair, each of which moves the source's cloud."""

import numpy as np
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Hypothesis, PairKey, PairRegistration, Registration, hypothesis_label
from multilica.sinks.rerun.entity_paths import CURVES, curve_path, lidar_frame, pair_frame, pair_path
from multilica.sinks.rerun.matches import log_verdict_on_matches
from multilica.sinks.rerun.scene import ITERATION_TIMELINE, STEP_TIMELINE, RerunScene, rigid
from multilica.sinks.rerun.scored_points import log_scored_points
from multilica.sinks.rerun.verdict import log_verdict
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.pair_tables import pair_scores_markdown

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


def log_registration(scene: RerunScene, event: events.PairRegistered | events.LoopRegistered) -> None:
    """Log GICP's progress, the scored poses, then the pose with its verdict; of a refused loop no scores."""
    registration = event.registration
    pair, start = scene.state.pair_of(registration), registration.start_label
    _log_curves(scene, registration, start)
    if isinstance(event, events.LoopRegistered) and not registration.verdict.accepted:
        _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))
        return
    for scored in reversed(registration.registrations):
        _show_scored(scene, pair, scored)
    _log_with_verdict(scene, pair, registration)


def log_changed_verdict(scene: RerunScene, event: events.VerdictChanged) -> None:
    """Log the pose of a registration with its new verdict."""
    _log_with_verdict(scene, scene.state.pair_of(event.registration), event.registration)


def log_group_registration(scene: RerunScene, event: events.GroupsRegistered) -> None:
    """Log GICP's progress and the pose of two groups, between their roots."""
    registration, start = event.registration, f"merged-{len(scene.state.group_registrations)}"
    pair = scene.state.pair_of(registration)
    _log_curves(scene, registration, start)
    _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))


def _log_curves(scene: RerunScene, registration: PairRegistration, start: str) -> None:
    """Log GICP's progress, one step per observed iteration."""
    if not registration.steps:
        return
    pair = (registration.target, registration.source)
    colour = scene.pair_colour(*pair)
    line = rr.SeriesLines(names=f"{pair_label(*pair)} {start}", colors=colour, widths=2.0)
    for quantity in CURVES:
        path = curve_path(quantity, *pair, start)
        scene.log(path, line)
        values = np.array([getattr(moment, quantity) for moment in registration.steps], dtype=np.float64)
        rows = np.flatnonzero(np.isfinite(values))
        times = [
            rr.TimeColumn(STEP_TIMELINE, sequence=scene.step + 1 + rows),
            rr.TimeColumn(ITERATION_TIMELINE, sequence=[registration.steps[row].iteration for row in rows]),
        ]
        if len(rows):  # in columns, which avoids the overhead of rows
            scene.stream.send_columns(path, times, rr.Scalars.columns(scalars=values[rows]))
    scene.advance(len(registration.steps) + 1)


def _log_with_verdict(scene: RerunScene, pair: PairKey, registration: PairRegistration) -> None:
    start = registration.start_label
    _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))
    _log_before(scene, pair, registration)
    log_verdict(scene, pair, start, registration)
    _log_scores(scene, pair, registration.registrations[0] if registration.registrations else None)


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
    frame = pair_frame(target, source, start)
    pose, axes = rigid(frame, lidar_frame(target), T_target_source), rr.TransformAxes3D(_AXIS_LENGTH_M)
    scene.log(pair_path(target, source, "poses", start), rr.CoordinateFrame(frame), pose, axes)
    _show_at(scene, pair, start)


def _show_at(scene: RerunScene, pair: PairKey, start: str) -> None:
    """Move the source's cloud into that pose's frame; log its points with the first pose."""
    target, source = pair
    cloud = scene.state.clouds.get(source)
    path, frame = pair_path(target, source, "source"), pair_frame(target, source, start)
    if cloud is not None and path not in scene.shown:
        scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points)
    else:
        scene.log_in(frame, path)


def _show_scored(scene: RerunScene, pair: PairKey, scored: Registration) -> None:
    scene.advance()
    scene.shown_at[scored] = scene.step
    _log_pose(scene, pair, scored.label, scored.T_target_source.with_target(pair[0]))
    log_scored_points(scene, pair, scored.label, scored)
    _log_scores(scene, pair, scored)


def starting_hypothesis(state: RunState, pair: PairKey, registration: PairRegistration) -> Hypothesis | None:
    """Return the hypothesis from which GICP started; None if it started from a pose that other pairs imply."""
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    return hypotheses[registration.hypothesis] if 0 <= registration.hypothesis < len(hypotheses) else None


def _log_before(scene: RerunScene, pair: PairKey, registration: PairRegistration) -> None:
    """Log the source at the hypothesis from which GICP started."""
    target, source = pair
    hypothesis, cloud = starting_hypothesis(scene.state, pair, registration), scene.state.clouds.get(source)
    if hypothesis is None or cloud is None:
        return
    frame, path = pair_frame(target, source, "before"), pair_path(target, source, "before")
    pose = hypothesis.T_target_source
    scene.log(pair_path(target, source, "before", "pose"), rigid(frame, lidar_frame(target), pose))
    scene.log_points(path, frame, cloud.points_m, scene.colour(source), scene.limits.pair_points // 3)


def _log_scores(scene: RerunScene, pair: PairKey, shown: Hypothesis | Registration | None) -> None:
    text = pair_scores_markdown(scene.state, pair, shown, scene.shown_at)
    scene.log_document(pair_path(*pair, "scores"), text)
