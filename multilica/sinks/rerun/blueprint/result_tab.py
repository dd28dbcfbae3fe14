# SPDX-License-Identifier: Apache-2.0
"""First tab of a run that placed something."""

import numpy as np
import rerun.blueprint as rrb

from multilica.geometry import FloatArray
from multilica.results import CalibrationResult
from multilica.sinks.rerun.blueprint.camera import around_rig, three_quarter, up_axis
from multilica.sinks.rerun.blueprint.views import scene_view, summary_view
from multilica.sinks.rerun.tree import GROUND, lidar_frame, lidar_path
from multilica.sinks.run_state import RunState

__all__ = ["result_tab"]


def result_tab(state: RunState) -> rrb.Container | None:
    """Show the merged cloud, the summary, and the rig with fields of view and uncertainty."""
    result = state.result
    if result is None or not state.target:
        return None
    placed = [place.lidar for place in result.placements if place.placed]
    clouds = [lidar_path(lidar, "preprocessed") for lidar in placed]
    sensors = [f"{lidar_path(lidar, part)}/**" for lidar in placed for part in ("sensor", "name")]
    extents = [lidar_path(lidar, part) for lidar in placed for part in ("field_of_view", "uncertainty")]
    frame = lidar_frame(result.target)
    merged = scene_view("Merged cloud", frame, [*clouds, *sensors, GROUND], around_rig(state))
    rig = scene_view("Rig", frame, [*sensors, *extents], _rig_eye(result, up_axis(state, result.target)), grid=True)
    side = rrb.Vertical(summary_view(), rig, row_shares=[1, 1])
    return rrb.Horizontal(merged, side, column_shares=[3, 2], name="Result")


def _rig_eye(result: CalibrationResult, up: FloatArray) -> rrb.EyeControls3D:
    poses = [place.T_target_source for place in result.placements if place.placed]
    origins_m = np.array([pose.xyz_m for pose in poses if pose is not None])
    centre_m = origins_m.mean(axis=0)
    radius_m = 3.0 + float(np.linalg.norm(origins_m - centre_m, axis=1).max())
    return three_quarter(centre_m, radius_m, up)
