# SPDX-License-Identifier: Apache-2.0
"""Matches, poses, scored points and verdicts of a pair."""

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.diagnosis.explanation import REASON_WORDS, by_weight
from multilica.geometry import FloatArray, RigidTransform, fixed_sign, largest_index
from multilica.results import (
    BeamLabel,
    BoolArray,
    Correspondences,
    Hypothesis,
    PairKey,
    PairRegistration,
    Registration,
    hypothesis_label,
)
from multilica.sinks import drawing
from multilica.sinks.drawing import kept_matches, match_lines, sample_indices, shown_radius_m
from multilica.sinks.rerun.scene import (
    CURVES,
    ITERATION_TIMELINE,
    PAIRS,
    STEP_TIMELINE,
    RerunScene,
    curve_path,
    lidar_frame,
    pair_frame,
    pair_path,
    rigid,
)
from multilica.sinks.run_state import RunState, failures
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import pair_scores_markdown

_LIFT_PER_RADIUS = 0.5
_COLOURS = {
    BeamLabel.UNSEEN: drawing.UNSEEN,
    BeamLabel.AGREE: drawing.AGREE,
    BeamLabel.VIOLATE: drawing.VIOLATE,
    BeamLabel.OCCLUDED: drawing.OCCLUDED,
}
_MATCH_LINES = {"undecided": (drawing.MUTED, 0.25), "rejected": (drawing.REJECTED, 0.25), "kept": (drawing.KEPT, 1.2)}
"""Colour and radius in pixels."""
_ARROW_M = 4.0
_AXIS_LENGTH_M = 0.5


def log_matches(scene: RerunScene, event: events.CorrespondencesMatched) -> None:
    """Log all matches, before the coarse stage keeps or rejects them."""
    matches = event.correspondences
    target, source = matches.target, matches.source
    pose = _lifted(scene, matches, RigidTransform.identity(target, source))
    features = scene.state.features.get(source)
    if features is not None:
        path = pair_path(target, source, "matches", "source")
        frame = pair_frame(target, source, "lifted")
        limit = scene.limits_of((target, source)).pair_points
        scene.log_points(path, frame, features.points_m, scene.colour(source), limit)
    _log_lines(scene, matches, pose, undecided=np.ones(len(matches), dtype=np.bool_))


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


def _log_lines(scene: RerunScene, matches: Correspondences, pose: RigidTransform, **chosen: BoolArray) -> None:
    """Log the matches of each kind of `_MATCH_LINES` as lines."""
    limit = scene.limits_of((matches.target, matches.source)).matches
    for kind, rows in chosen.items():
        colour, radius_pixels = _MATCH_LINES[kind]
        lines = match_lines(matches, rows, pose, limit).astype(np.float32)
        strips = rr.LineStrips3D(lines, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
        scene.log_in(lidar_frame(matches.target), pair_path(matches.target, matches.source, "matches", kind), strips)


def _log_beam_labels(scene: RerunScene) -> None:
    """Log the classes of scored points, once: two bytes a point instead of a colour each."""
    if PAIRS in scene.shown:
        return
    scene.shown.add(PAIRS)
    classes = [
        rr.AnnotationInfo(id=int(label), label=label.name.lower(), color=colour) for label, colour in _COLOURS.items()
    ]
    scene.stream.log(PAIRS, rr.AnnotationContext(classes), static=True)


def _log_scored_points(scene: RerunScene, pair: PairKey, start: str, scored: Registration) -> None:
    """Log the scored points of both sides by label, the source's at a pose; repeat those in proven-empty space, larger.

    The pair is as it was matched; the registration may be in either order.
    """
    _log_beam_labels(scene)
    source = (scored.probes_m, scored.visibility.labels)
    target = (scored.target_probes_m, scored.visibility.target_labels)
    if scored.T_target_source.target != pair[0]:
        source, target = target, source
    limit = scene.limits_of(pair).scored_points
    _log_side(scene, pair_path(*pair, "scored", "source"), pair_frame(*pair, start), *source, limit)
    _log_side(scene, pair_path(*pair, "scored", "target"), lidar_frame(pair[0]), *target, limit)
    violations_m, target_violations_m = (points_m[labels == BeamLabel.VIOLATE] for points_m, labels in (source, target))
    moved_m = scored.T_target_source.with_target(pair[0]).apply(violations_m)
    points = np.concatenate([moved_m, target_violations_m]).astype(np.float32)
    shown = rr.Points3D(points, colors=[drawing.VIOLATE], radii=rr.Radius.ui_points(4.0))
    scene.log_in(lidar_frame(pair[0]), pair_path(*pair, "scored", "violations"), shown)


def _log_side(
    scene: RerunScene, path: str, frame: str, points_m: FloatArray, labels: npt.NDArray[np.uint8], limit: int
) -> None:
    """Log the points with their first labels; for later poses only new labels, and for the source a new frame."""
    rows = sample_indices(len(points_m), limit)
    classes = labels[rows].astype(np.uint16)
    if path in scene.shown:
        scene.log_in(frame, path, rr.Points3D.from_fields(class_ids=classes))
        return
    shown = rr.Points3D(points_m[rows].astype(np.float32), class_ids=classes, radii=rr.Radius.ui_points(2.5))
    scene.log_in(frame, path, shown)


def _log_verdict(scene: RerunScene, pair: PairKey, start: str, registration: PairRegistration) -> None:
    """Log the verdict at the source's origin, the competing pose, and arrows along unconstrained directions."""
    outcome, (first, *others) = registration.verdict.outcome, by_weight(registration.verdict.codes) or ("",)
    more = f" and {len(others)} more" if others else ""
    words = f"{outcome}: {REASON_WORDS.get(first, first)}{more}" if first else outcome
    label = f"{pair_label(registration.target, registration.source)} {words}"
    _log_label(scene, pair_path(*pair, "verdict"), pair_frame(*pair, start), label, outcome)
    _log_competing(scene, pair, "competing pose")
    if "not_observable" in registration.verdict.codes:
        own = registration.target == pair[0]
        frame = lidar_frame(pair[0]) if own else pair_frame(*pair, start)
        _log_slide(scene, pair, registration, frame)


def log_contested_places(scene: RerunScene) -> None:
    """Log both places of each LiDAR that two accepted pairs put at different places."""
    for failure in failures(scene.state):
        pair = failure.pair
        if pair is None or failure.elsewhere is None:
            continue
        other = next(name for name in failure.elsewhere if name != failure.lidar)
        label = f"{pair_label(*scene.state.registered(pair))} accept, but {other} puts {failure.lidar} elsewhere"
        start = scene.state.registrations[pair].start_label
        _log_label(scene, pair_path(*pair, "verdict"), pair_frame(*pair, start), label, "undecided")
        _log_competing(scene, pair, f"where {other} puts {failure.lidar}")


def _log_label(scene: RerunScene, path: str, frame: str, label: str, outcome: str) -> None:
    """Log a label at the origin of a frame."""
    point = rr.Points3D(
        [(0.0, 0.0, 0.0)], colors=[drawing.VERDICT_COLOURS[outcome]], labels=[label], radii=rr.Radius.ui_points(7.0)
    )
    scene.log_in(frame, path, point)


def _log_competing(scene: RerunScene, pair: PairKey, words: str) -> None:
    competing, cloud = scene.state.competing(pair), scene.state.clouds.get(pair[1])
    if competing is None or cloud is None:
        return
    frame = pair_frame(*pair, "competing")
    pose = competing.T_target_source.with_target(pair[0])
    scene.log(pair_path(*pair, "competing", "pose"), rigid(frame, lidar_frame(pair[0]), pose))
    path, limit = pair_path(*pair, "competing"), scene.limits_of(pair).pair_points // 3
    scene.log_points(path, frame, cloud.points_m, scene.colour(pair[1]), limit)
    _log_fitting(scene, pair, competing)
    beams = competing.visibility
    label = f"{pair[1]}, {words}: {beams.agree:,} points agree, {beams.violate:,} lie in proven-empty space"
    _log_label(scene, pair_path(*pair, "competing", "label"), frame, label, "undecided")


def _log_fitting(scene: RerunScene, pair: PairKey, competing: Registration) -> None:
    """Log the points of both LiDARs that agree with the other's surfaces at the competing pose as well."""
    of_source = (competing.probes_m, competing.visibility.labels)
    of_target = (competing.target_probes_m, competing.visibility.target_labels)
    if competing.T_target_source.target != pair[0]:
        of_source, of_target = of_target, of_source
    frames = {"target": lidar_frame(pair[0]), "source": pair_frame(*pair, "competing")}
    for (part, frame), (points_m, labels) in zip(frames.items(), (of_target, of_source), strict=True):
        fitting_m = points_m[labels == BeamLabel.AGREE]
        rows = sample_indices(len(fitting_m), scene.limits_of(pair).scored_points)
        shown = rr.Points3D(fitting_m[rows].astype(np.float32), colors=[drawing.AGREE], radii=rr.Radius.ui_points(2.5))
        scene.log_in(frame, pair_path(*pair, "competing", "fitting", part), shown)


def _log_slide(scene: RerunScene, pair: PairKey, registration: PairRegistration, frame: str) -> None:
    """Log arrows both ways along the least constrained translation, or along the axis of that rotation.

    The frame is that of the registration's target. A label would cover that of another reason, if this is not the main.
    """
    weakest = fixed_sign(registration.registrations[0].visibility.weakest_direction)
    rotates = largest_index(weakest) < 3
    axis, word = (weakest[:3], "rotation about this axis") if rotates else (weakest[3:], "translation")
    axis = axis / np.linalg.norm(axis)
    origin_m = registration.T_target_source.xyz_m
    weightiest = by_weight(registration.verdict.codes)[0] == "not_observable"
    arrows = rr.Arrows3D(
        origins=[origin_m, origin_m],
        vectors=[_ARROW_M * axis, -_ARROW_M * axis],
        colors=[drawing.UNDECIDED],
        labels=[f"{word} is not constrained", ""] if weightiest else None,
        radii=0.06,
    )
    scene.log_in(frame, pair_path(*pair, "slide"), arrows)


def log_hypotheses(scene: RerunScene, event: events.HypothesesFound) -> None:
    """Log every hypothesis of a pair, one step each, the best last; then the matches that it keeps, if there is one."""
    pair = (event.coarse.target, event.coarse.source)
    hypotheses = event.coarse.hypotheses
    for index, one in reversed([*enumerate(hypotheses)]):
        scene.advance()
        scene.shown_at[one] = scene.step
        _log_pose(scene, pair, hypothesis_label(index, one.origin), one.T_target_source)
    best = hypotheses[0] if hypotheses else None
    matches = event.correspondences
    pose = _lifted(scene, matches, best.T_target_source if best else RigidTransform.identity(*pair))
    kept = kept_matches(scene.state, matches, best) if best else np.zeros(len(matches), dtype=np.bool_)
    _log_lines(scene, matches, pose, undecided=np.zeros_like(kept), rejected=~kept, kept=kept)
    _log_scores(scene, pair, best)


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
    log_verdict(scene, event)


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


def log_verdict(
    scene: RerunScene, event: events.PairRegistered | events.LoopRegistered | events.VerdictChanged
) -> None:
    """Log the pose of a registration with its verdict."""
    registration = event.registration
    pair, start = scene.state.pair_of(registration), registration.start_label
    _log_pose(scene, pair, start, registration.T_target_source.with_target(pair[0]))
    _log_before(scene, pair, registration)
    _log_verdict(scene, pair, start, registration)
    _log_scores(scene, pair, registration.registrations[0] if registration.registrations else None)


def show_best_poses(scene: RerunScene) -> None:
    """Move each pair's source cloud to its best pose."""
    state = scene.state
    for pair in state.pairs:
        hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
        if pair in state.registrations:
            _show_at(scene, pair, state.registrations[pair].start_label)
        elif state.verified.get(pair):
            _show_at(scene, pair, state.verified[pair][0].label)
        elif hypotheses:
            _show_at(scene, pair, hypothesis_label(0, hypotheses[0].origin))


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
        limit = scene.limits_of(pair).pair_points
        scene.log_points(path, frame, cloud.points_m, scene.colour(source), limit)
    else:
        scene.log_in(frame, path)


def _show_scored(scene: RerunScene, pair: PairKey, scored: Registration) -> None:
    scene.advance()
    scene.shown_at[scored] = scene.step
    _log_pose(scene, pair, scored.label, scored.T_target_source.with_target(pair[0]))
    _log_scored_points(scene, pair, scored.label, scored)
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
    limit = scene.limits_of(pair).pair_points // 3
    scene.log_points(path, frame, cloud.points_m, scene.colour(source), limit)


def _log_scores(scene: RerunScene, pair: PairKey, shown: Hypothesis | Registration | None) -> None:
    text = pair_scores_markdown(scene.state, pair, shown, scene.shown_at)
    scene.log_document(pair_path(*pair, "scores"), text)
