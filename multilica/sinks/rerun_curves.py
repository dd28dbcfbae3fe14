# SPDX-License-Identifier: Apache-2.0
"""The progress of GICP as curves."""

from __future__ import annotations

import math

import rerun as rr

from multilica.results import PairRegistration
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
"""What is drawn of each `FineStep`, with its title."""


def log_curves(scene: Scene, registration: PairRegistration, start: str) -> None:
    """One step per observed moment, which is also its iteration on the other timeline."""
    if not registration.steps:
        return
    pair = (registration.target, registration.source)
    line = rr.SeriesLines(names=f"{pair_label(*pair)} {start}", colors=_colour(scene, registration), widths=2.0)
    for quantity in CURVES:
        scene.log(curve_path(quantity, *pair, start), line)
        values = [float(getattr(moment, quantity)) for moment in registration.steps]
        rows = [row for row, value in enumerate(values) if math.isfinite(value)]
        steps = [scene.step + 1 + row for row in rows]
        iterations = [registration.steps[row].iteration for row in rows]
        scene.log_curve(curve_path(quantity, *pair, start), steps, iterations, [values[row] for row in rows])
    scene.advance(len(registration.steps) + 1)


def _colour(scene: Scene, registration: PairRegistration) -> Rgb:
    pairs = scene.story.pairs
    labels = [pair_label(*pair) for pair in pairs]
    return distinct_colours(labels)[pair_label(*scene.story.pair_of(registration))]
