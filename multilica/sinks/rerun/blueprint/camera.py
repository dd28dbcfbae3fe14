# SPDX-License-Identifier: Apache-2.0
"""Cameras of the views."""

import numpy as np
import rerun.blueprint as rrb

from multilica.geometry import FloatArray
from multilica.sinks.drawing.clouds import sample_points, shown_radius_m, slot_offsets_m
from multilica.sinks.run_state import RunState

_SAMPLE = 20_000
_FAR_SHARE = 75.0
_RADIUS_LIMITS_M = (6.0, 40.0)
_ASIDE_M = 1.0


def around_lidar(state: RunState, lidar: str, *, zoom: float = 1.0, raised_m: float = 0.0) -> rrb.EyeControls3D:
    """Look at one LiDAR's cloud in its own frame, or at a point above it; a smaller zoom shows more around it."""
    centre_m, radius_m = _extent_of(state, lidar)
    centre_m = centre_m + np.array([0.0, 0.0, raised_m])
    return three_quarter(centre_m, radius_m / zoom, up_axis(state, lidar))


def beside_lidar(state: RunState, lidar: str) -> rrb.EyeControls3D:
    """Look at one LiDAR's cloud from the side, for a view that is wider than high."""
    centre_m, radius_m = _extent_of(state, lidar)
    up = up_axis(state, lidar)
    ahead, aside = _horizontal(up, centre_m)
    position = centre_m + radius_m * (-0.5 * ahead - 1.3 * aside + 1.1 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def _extent_of(state: RunState, lidar: str) -> tuple[FloatArray, float]:
    if lidar in state.clouds and lidar not in state.extents:
        state.extents[lidar] = _extent(sampled_cloud(state, lidar))
    return state.extents.get(lidar) or _extent(np.empty((0, 3)))


def around_rig(state: RunState) -> rrb.EyeControls3D:
    """Look at the clouds of all LiDARs with a pose, in the target's frame."""
    placements = state.result.placements if state.result is not None else ()
    clouds = [
        place.T_target_source.apply(sampled_cloud(state, place.lidar))
        for place in placements
        if place.T_target_source is not None
    ]
    target = state.result.target if state.result is not None else ""
    return three_quarter(*_extent(np.concatenate([np.empty((0, 3)), *clouds])), up_axis(state, target))


def three_quarter(centre_m: FloatArray, radius_m: float, up: FloatArray) -> rrb.EyeControls3D:
    """Look from behind, the side and above, so that the radius fills the view."""
    ahead, aside = _horizontal(up)
    position = centre_m + radius_m * (-1.05 * ahead - 0.55 * aside + 0.95 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def above_group(state: RunState) -> rrb.EyeControls3D:
    """Look down on the slot in which the target's group grows, slightly tilted, z up."""
    offsets_m = slot_offsets_m(state.snapshot) if state.snapshot is not None else {}
    centre_m = np.array([0.0, offsets_m.get(state.target, 0.0), 0.0])
    radius_m = shown_radius_m(sampled_cloud(state, state.target))
    position = centre_m + 2.0 * radius_m * np.array([-0.7, 0.0, 0.9])
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=(0.0, 0.0, 1.0))


def sampled_cloud(state: RunState, lidar: str) -> FloatArray:
    """Return a sample (N, 3) of a LiDAR's preprocessed points; none before it is preprocessed."""
    if lidar not in state.clouds:
        return np.empty((0, 3))
    return sample_points(state.clouds[lidar].points_m, _SAMPLE).astype(np.float64)


def up_axis(state: RunState, lidar: str) -> FloatArray:
    """Return the up axis (3,) in the LiDAR's frame: its z axis until its pose and the ground are known."""
    up = np.array([0.0, 0.0, 1.0])
    if state.result is None:
        return up
    if state.result.ground is not None:
        up = state.result.ground.normal
    for place in state.result.placements:
        if place.lidar == lidar and place.T_target_source is not None:
            return np.asarray(place.T_target_source.rotation.T @ up)
    return np.array([0.0, 0.0, 1.0])


def _extent(points_m: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of the dense part of a cloud (N, 3).

    The centre of a LiDAR that looks one way lies between its cloud and the sensor.
    """
    if len(points_m) == 0:
        return np.zeros(3), _RADIUS_LIMITS_M[0]
    centre_m = 0.6 * np.median(points_m, axis=0)
    radius_m = np.percentile(np.linalg.norm(points_m - centre_m, axis=1), _FAR_SHARE)
    return centre_m, float(np.clip(radius_m, *_RADIUS_LIMITS_M))


def _horizontal(up: FloatArray, towards_m: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the level directions ahead and left.

    Args:
        towards_m: (3,) point ahead; x, or y where x is nearly up, if it is not given or close to the sensor.
    """
    axis = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    if towards_m is not None and np.linalg.norm(np.cross(up, towards_m)) > _ASIDE_M:
        axis = towards_m
    ahead = axis - (axis @ up) * up
    ahead /= np.linalg.norm(ahead)
    return ahead, np.cross(up, ahead)
