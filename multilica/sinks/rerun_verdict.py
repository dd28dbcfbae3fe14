# SPDX-License-Identifier: Apache-2.0
"""Why a pair is believed or not, drawn where it is to be seen."""

from __future__ import annotations

import numpy as np
import rerun as rr

from multilica.explanation.causes import REASON_WORDS, by_weight
from multilica.results import Assessment, PairKey, PairRegistration
from multilica.sinks.failures import Failure
from multilica.sinks.narration import pair_label
from multilica.sinks.palette import UNDECIDED, VERDICT_COLOURS
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import hypothesis_frame, lidar_frame, pair_path
from multilica.sinks.rival_pose import rival_of
from multilica.sinks.run_story import as_matched

__all__ = ["log_contested_place", "log_verdict", "verdict_words"]

_ARROW_M = 4.0


def verdict_words(registration: PairRegistration) -> str:
    """The verdict with its weightiest reason, short enough for a label."""
    verdict = registration.verdict
    first, *others = by_weight(reason.code for reason in verdict.reasons) or ("",)
    more = f" and {len(others)} more" if others else ""
    return f"{verdict.outcome}: {REASON_WORDS.get(first, first)}{more}" if first else verdict.outcome


def log_verdict(scene: Scene, pair: PairKey, start: str, registration: PairRegistration) -> None:
    """The verdict at the source's origin; the rival pose with its cloud; arrows along which the pose can slide."""
    label = f"{pair_label(*pair)} {verdict_words(registration)}"
    _log_label(scene, pair_path(*pair, "verdict"), hypothesis_frame(*pair, start), label, registration.verdict.outcome)
    _log_rival(scene, pair, rival_of(scene.story, registration), "the other pose")
    if any(reason.code == "not_observable" for reason in registration.verdict.reasons):
        own = registration.target == pair[0]
        frame = lidar_frame(pair[0]) if own else hypothesis_frame(*pair, start)
        _log_slide(scene, pair, registration, frame)


def log_contested_place(
    scene: Scene, failure: Failure, pair: PairKey, start: str, registration: PairRegistration
) -> None:
    """Of an accepted pair, where another accepted pair puts the LiDAR that was left out for it."""
    other = next(name for name in failure.elsewhere or () if name != failure.lidar)
    label = f"{pair_label(*pair)} accept, but {other} puts {failure.lidar} elsewhere"
    _log_label(scene, pair_path(*pair, "verdict"), hypothesis_frame(*pair, start), label, "undecided")
    _log_rival(scene, pair, rival_of(scene.story, registration), f"where {other} puts {failure.lidar}")


def _log_label(scene: Scene, path: str, frame: str, label: str, outcome: str) -> None:
    """Words at the origin of a frame."""
    point = rr.Points3D(
        [(0.0, 0.0, 0.0)], colors=[VERDICT_COLOURS[outcome]], labels=[label], radii=rr.Radius.ui_points(7.0)
    )
    scene.log(path, rr.CoordinateFrame(frame), point)


def _log_rival(scene: Scene, pair: PairKey, rival: Assessment | None, words: str) -> None:
    cloud = scene.story.clouds.get(pair[1])
    if rival is None or cloud is None:
        return
    frame = hypothesis_frame(*pair, "rival")
    pose = as_matched(pair, rival.T_target_source)
    scene.log(pair_path(*pair, "rival", "pose"), rigid(frame, lidar_frame(pair[0]), pose))
    path, limit = pair_path(*pair, "rival"), scene.limits.pair_points // 3
    scene.log_points(path, frame, cloud.points_m, scene.colour(pair[1]), limit)
    beams = rival.testimony
    label = f"{pair[1]}, {words}: {beams.agree:,} points agree, {beams.violate:,} stand in empty space"
    _log_label(scene, pair_path(*pair, "rival", "label"), frame, label, "undecided")


def _log_slide(scene: Scene, pair: PairKey, registration: PairRegistration, frame: str) -> None:
    """Both ways along the direction of the weakest motion, or along the axis about which it turns.

    In words only if it is what the verdict rests on: they would cover the label of another reason.

    Args:
        frame: that of the registration's target, wherever the pair puts it.
    """
    turn, shift = np.split(registration.assessments[0].testimony.weakest_direction, 2)
    axis, word = (shift, "slides") if np.abs(shift).max() >= np.abs(turn).max() else (turn, "turns about this")
    axis = axis / np.linalg.norm(axis)
    origin_m = registration.T_target_source.xyz_m
    weightiest = by_weight(reason.code for reason in registration.verdict.reasons)[0] == "not_observable"
    arrows = rr.Arrows3D(
        origins=[origin_m, origin_m],
        vectors=[_ARROW_M * axis, -_ARROW_M * axis],
        colors=[UNDECIDED],
        labels=[f"{word}: nothing holds it", ""] if weightiest else None,
        radii=0.06,
    )
    scene.log(pair_path(*pair, "slide"), rr.CoordinateFrame(frame), arrows)
