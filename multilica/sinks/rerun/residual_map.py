# SPDX-License-Identifier: Apache-2.0
"""Heat map of the merged cloud's residual."""

import numpy as np
import rerun as rr

from multilica import events
from multilica.sinks.drawing.clouds import sample_indices
from multilica.sinks.drawing.palette import heat_colours
from multilica.sinks.rerun.entity_paths import lidar_frame, lidar_path
from multilica.sinks.rerun.scene import RerunScene

RESIDUAL_SCALE_M = 0.05
"""Residual with the brightest colour: a few times the range noise of vehicle LiDARs."""

# The darkest colours of the scale can hardly be seen on the background.
_DARKEST = 0.15


def log_residuals(scene: RerunScene, event: events.ResidualsMeasured) -> None:
    """Log the points of a LiDAR that others saw as well, coloured by their distance to the others' surfaces."""
    found = event.residuals
    rows = sample_indices(len(found.points_m), scene.limits.cloud_points)
    colours = heat_colours(_DARKEST + (1.0 - _DARKEST) * found.residual_m[rows] / RESIDUAL_SCALE_M)
    shown = rr.Points3D(found.points_m[rows].astype(np.float32), colors=colours, radii=rr.Radius.ui_points(2.0))
    scene.log_in(lidar_frame(found.lidar), lidar_path(found.lidar, "residual"), shown)
