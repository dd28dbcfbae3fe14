# SPDX-License-Identifier: Apache-2.0
"""Verdicts drawn at the poses that they are about."""

import numpy as np
import rerun as rr

from multilica.diagnosis.causes import REASON_WORDS, by_weight
from multilica.geometry import fixed_sign, largest_index
from multilica.results import PairKey, PairRegistration, Registration
from multilica.sinks.drawing.palette import UNDECIDED, VERDICT_COLOURS
from multilica.sinks.rerun.entity_paths import lidar_frame, pair_frame, pair_path
from multilica.sinks.rerun.scene import RerunScene, rigid
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.unplaced import failures

_ARROW_M = 4.0


def log_verdict(scene: RerunScene, pair: PairKey, start: str, registration: PairRegistration) -> None:
    """Log the verdict at the source's origin, the competing pose, and arrows along unconstrained directions."""
    label = f"{pair_label(*pair)} {_verdict_words(registration)}"
    _log_label(scene, pair_path(*pair, "verdict"), pair_frame(*pair, start), label, registration.verdict.outcome)
    _log_competing(scene, pair, scene.state.competing(pair), "competing pose")
    if any(reason.code == "not_observable" for reason in registration.verdict.reasons):
        own = registration.target == pair[0]
        frame = lidar_frame(pair[0]) if own else pair_frame(*pair, start)
        _log_slide(scene, pair, registration, frame)


def _verdict_words(registration: PairRegistration) -> str:
    """Return the verdict with its main reason, short enough for a label."""
    verdict = registration.verdict
    first, *others = by_weight(reason.code for reason in verdict.reasons) or ("",)
    more = f" and {len(others)} more" if others else ""
    return f"{verdict.outcome}: {REASON_WORDS.get(first, first)}{more}" if first else verdict.outcome


def log_contested_places(scene: RerunScene) -> None:
    """Log both places of each LiDAR that two accepted pairs put at different places."""
    for failure in failures(scene.state):
        pair = failure.pair
        if pair is None or failure.elsewhere is None:
            continue
        other = next(name for name in failure.elsewhere if name != failure.lidar)
        label = f"{pair_label(*pair)} accept, but {other} puts {failure.lidar} elsewhere"
        start = scene.state.registrations[pair].start_label
        _log_label(scene, pair_path(*pair, "verdict"), pair_frame(*pair, start), label, "undecided")
        _log_competing(scene, pair, scene.state.competing(pair), f"where {other} puts {failure.lidar}")


def _log_label(scene: RerunScene, path: str, frame: str, label: str, outcome: str) -> None:
    """Log a label at the origin of a frame."""
    point = rr.Points3D(
        [(0.0, 0.0, 0.0)], colors=[VERDICT_COLOURS[outcome]], labels=[label], radii=rr.Radius.ui_points(7.0)
    )
    scene.log_in(frame, path, point)


def _log_competing(scene: RerunScene, pair: PairKey, competing: Registration | None, words: str) -> None:
    cloud = scene.state.clouds.get(pair[1])
    if competing is None or cloud is None:
        return
    frame = pair_frame(*pair, "competing")
    pose = competing.T_target_source.with_target(pair[0])
    scene.log(pair_path(*pair, "competing", "pose"), rigid(frame, lidar_frame(pair[0]), pose))
    path, limit = pair_path(*pair, "competing"), scene.limits.pair_points // 3
    scene.log_points(path, frame, cloud.points_m, scene.colour(pair[1]), limit)
    beams = competing.visibility
    label = f"{pair[1]}, {words}: {beams.agree:,} points agree, {beams.violate:,} lie in proven-empty space"
    _log_label(scene, pair_path(*pair, "competing", "label"), frame, label, "undecided")


def _log_slide(scene: RerunScene, pair: PairKey, registration: PairRegistration, frame: str) -> None:
    """Log arrows both ways along the least constrained translation, or along the axis of that rotation.

    They have a label only if this is the main reason, since it would cover the label of another one.

    Args:
        frame: of the registration's target.
    """
    weakest = fixed_sign(registration.registrations[0].visibility.weakest_direction)
    rotates = largest_index(weakest) < 3
    axis, word = (weakest[:3], "rotation about this axis") if rotates else (weakest[3:], "translation")
    axis = axis / np.linalg.norm(axis)
    origin_m = registration.T_target_source.xyz_m
    weightiest = by_weight(reason.code for reason in registration.verdict.reasons)[0] == "not_observable"
    arrows = rr.Arrows3D(
        origins=[origin_m, origin_m],
        vectors=[_ARROW_M * axis, -_ARROW_M * axis],
        colors=[UNDECIDED],
        labels=[f"{word} is not constrained", ""] if weightiest else None,
        radii=0.06,
    )
    scene.log_in(frame, pair_path(*pair, "slide"), arrows)
