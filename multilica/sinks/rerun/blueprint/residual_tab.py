# SPDX-License-Identifier: Apache-2.0
"""Tab with the residual of the merged cloud."""

import rerun.blueprint as rrb

from multilica.sinks.rerun.blueprint.camera import around_rig
from multilica.sinks.rerun.blueprint.views import scene_view
from multilica.sinks.rerun.entity_paths import lidar_frame, lidar_path
from multilica.sinks.rerun.residual_map import RESIDUAL_SCALE_M
from multilica.sinks.run_state import RunState


def residual_tab(state: RunState) -> rrb.Container | None:
    """Show where the merged clouds meet, and where they do not; None where no two LiDARs are joined."""
    result = state.result
    if result is None or len(result.placements) < 2 or not state.residuals:
        return None
    contents = [
        path
        for lidar in sorted(state.residuals)
        for path in (lidar_path(lidar, "residual"), f"{lidar_path(lidar, 'name')}/**")
    ]
    name = f"Distance to the other LiDARs' surfaces: dark 0 m, bright {RESIDUAL_SCALE_M:g} m or more"
    view = scene_view(name, lidar_frame(result.target), contents, around_rig(state))
    return rrb.Horizontal(view, name="Residual")
