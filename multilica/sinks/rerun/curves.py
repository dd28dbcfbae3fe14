# SPDX-License-Identifier: Apache-2.0
"""Curves of the progress of GICP."""

import math

import rerun as rr

from multilica.results import PairRegistration
from multilica.sinks.drawing.palette import distinct_colours
from multilica.sinks.rerun.scene import RerunScene
from multilica.sinks.rerun.tree import curve_path
from multilica.sinks.text.log_lines import pair_label

__all__ = ["CURVES", "log_curves"]

CURVES = {
    "inliers": "inliers",
    "error": "GICP cost",
    "translation_step_m": "translation per step, m",
    "rotation_step_rad": "rotation per step, rad",
}
"""Fields of `GicpStep` with the titles of their plots."""


def log_curves(scene: RerunScene, registration: PairRegistration, start: str) -> None:
    """Log GICP's progress, one step per observed iteration."""
    if not registration.steps:
        return
    pair = (registration.target, registration.source)
    colours = distinct_colours([pair_label(*each) for each in scene.state.pairs])
    colour = colours[pair_label(*scene.state.pair_of(registration))]
    line = rr.SeriesLines(names=f"{pair_label(*pair)} {start}", colors=colour, widths=2.0)
    for quantity in CURVES:
        scene.log(curve_path(quantity, *pair, start), line)
        values = [float(getattr(moment, quantity)) for moment in registration.steps]
        rows = [row for row, value in enumerate(values) if math.isfinite(value)]
        steps = [scene.step + 1 + row for row in rows]
        iterations = [registration.steps[row].iteration for row in rows]
        scene.log_curve(curve_path(quantity, *pair, start), steps, iterations, [values[row] for row in rows])
    scene.advance(len(registration.steps) + 1)
