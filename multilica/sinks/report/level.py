# SPDX-License-Identifier: Apache-2.0
"""Which way is up."""

from __future__ import annotations

import numpy as np

from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.thinning import sample_points

__all__ = ["LEVEL", "level_pose"]

LEVEL = "level"
_ENOUGH_POINTS = 3_000


def level_pose(contents: ReportContents) -> RigidTransform | None:
    """The target LiDAR in a frame with z up from the ground below it; None where no ground is found.

    A LiDAR may be mounted tilted: pictures along its own axes would show a street as a ramp.
    """
    if contents.document["ground"] is not None:
        matrix = np.asarray(contents.document["ground"]["T_base_target"], dtype=np.float64)
        return RigidTransform(LEVEL, contents.target, matrix)
    points_m = _placed_points(contents)
    if len(points_m) == 0:
        return None
    from multilica.stages.ground import estimate_ground

    config = CalibrationConfig.model_validate(contents.document["config"])
    ground, _ = estimate_ground(contents.target, points_m, config.ground, config.runtime.seed)
    return None if ground is None else RigidTransform(LEVEL, contents.target, ground.T_base_target.matrix)


def _placed_points(contents: ReportContents) -> FloatArray:
    """(N, 3) a sample of what the placed LiDARs saw, in the target's frame."""
    poses = contents.placed_poses() or {contents.target: RigidTransform.identity(contents.target, contents.target)}
    known = {name: pose for name, pose in poses.items() if name in contents.clouds}
    share = _ENOUGH_POINTS // max(1, len(known))
    clouds = [pose.apply(sample_points(contents.clouds[name], share)) for name, pose in known.items()]
    return np.concatenate(clouds) if clouds else np.empty((0, 3))
