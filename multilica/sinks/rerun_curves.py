# SPDX-License-Identifier: Apache-2.0
"""The progress of GICP as curves."""

from __future__ import annotations

import math

import rerun as rr

from multilica.results import FineStep, PairRegistration
from multilica.sinks.narration import pair_label
from multilica.sinks.palette import Rgb, distinct_colours
from multilica.sinks.rerun_scene import Scene
from multilica.sinks.rerun_tree import curve_path

__all__ = ["CURVES", "log_curves"]

CURVES = {
    "inliers": "inliers",
    "error": "objective of the engine",
    "translation_step_m": "movement, m",
    "rotation_step_rad": "rotation, rad",
}
"""What is drawn, with its title."""


def log_curves(scene: Scene, registration: PairRegistration, start: str) -> None:
    """One step per observed moment, which is also its iteration on the other timeline."""
    if not registration.steps:
        return
    pair = (registration.target, registration.source)
    colour = _colour(scene, registration)
    for quantity in CURVES:
        line = rr.SeriesLines(names=f"{pair_label(*pair)} {start}", colors=colour, widths=2.0)
        scene.log(curve_path(quantity, *pair, start), line)
    for moment in registration.steps:
        scene.advance(moment.iteration)
        for quantity, value in _values(moment).items():
            scene.log(curve_path(quantity, *pair, start), rr.Scalars(value))
    scene.advance()


def _colour(scene: Scene, registration: PairRegistration) -> Rgb:
    pairs = scene.story.pairs
    labels = [pair_label(*pair) for pair in pairs]
    return distinct_colours(labels)[pair_label(*scene.story.pair_of(registration))]


def _values(moment: FineStep) -> dict[str, float]:
    values = {
        "inliers": float(moment.inliers),
        "error": moment.error,
        "translation_step_m": moment.translation_step_m,
        "rotation_step_rad": moment.rotation_step_rad,
    }
    return {quantity: value for quantity, value in values.items() if math.isfinite(value)}
