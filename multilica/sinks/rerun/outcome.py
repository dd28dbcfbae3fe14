# SPDX-License-Identifier: Apache-2.0
"""Calibrated rig in a recording."""

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.results import GroundPlane, LidarPlacement
from multilica.sinks.drawing.ellipsoid import SHOWN_ELLIPSOID_SCALE, uncertainty_ellipsoid
from multilica.sinks.drawing.palette import MUTED
from multilica.sinks.rerun.scene import RerunScene, rigid
from multilica.sinks.rerun.tree import GROUND, lidar_frame, lidar_path, slot_frame

__all__ = ["log_ground", "log_outcome"]

_GRID_HALF_SIZE_M = 15.0
_GRID_SPACING_M = 2.5


def log_outcome(scene: RerunScene, event: events.CalibrationFinished) -> None:
    """Log every placed LiDAR in the target's frame."""
    result = event.result
    if result.target in scene.state.lidars:
        scene.log(lidar_path(result.target, "sensor"), rigid(lidar_frame(result.target), slot_frame(result.target)))
    for place in result.placements:
        if place.placed and place.T_target_source is not None and place.lidar != result.target:
            pose = rigid(lidar_frame(place.lidar), lidar_frame(result.target), place.T_target_source)
            scene.log(lidar_path(place.lidar, "sensor"), pose)
            if place.covariance is not None:
                _log_uncertainty(scene, result.target, place)


def _log_uncertainty(scene: RerunScene, target: str, place: LidarPlacement) -> None:
    """Log the enlarged ellipsoid of the position in the target's frame."""
    ellipsoid = uncertainty_ellipsoid(place)
    if ellipsoid is None:
        return
    half_sizes_m, axes = ellipsoid
    shape = rr.Ellipsoids3D(
        centers=[place.T_target_source.xyz_m] if place.T_target_source else [],
        half_sizes=[SHOWN_ELLIPSOID_SCALE * half_sizes_m],
        quaternions=[rr.Quaternion(xyzw=axes.quaternion_xyzw)],
        colors=[scene.colour(place.lidar)],
        fill_mode=rr.components.FillMode.DenseWireframe,
    )
    scene.log(lidar_path(place.lidar, "uncertainty"), rr.CoordinateFrame(lidar_frame(target)), shape)


def log_ground(scene: RerunScene, event: events.GroundEstimated) -> None:
    """Log the ground plane as a grid around the point below the target LiDAR."""
    if event.ground is None or not scene.state.target:
        return
    strips = rr.LineStrips3D(_grid(event.ground), colors=[MUTED], radii=rr.Radius.ui_points(0.5))
    scene.log(GROUND, rr.CoordinateFrame(lidar_frame(scene.state.target)), strips)


def _grid(ground: GroundPlane) -> npt.NDArray[np.float32]:
    """Return segments (K, 2, 3) in the target's frame."""
    forward, left = ground.T_base_target.rotation[0], ground.T_base_target.rotation[1]
    centre = -ground.offset_m * ground.normal
    ticks = np.arange(-_GRID_HALF_SIZE_M, _GRID_HALF_SIZE_M + _GRID_SPACING_M, _GRID_SPACING_M)
    ends = np.array([-_GRID_HALF_SIZE_M, _GRID_HALF_SIZE_M])
    along = centre + ticks[:, None, None] * left + ends[None, :, None] * forward
    across = centre + ticks[:, None, None] * forward + ends[None, :, None] * left
    return np.concatenate([along, across]).astype(np.float32)
