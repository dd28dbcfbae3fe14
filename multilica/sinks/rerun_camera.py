# SPDX-License-Identifier: Apache-2.0
"""Where the viewer looks from."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from multilica.geometry import FloatArray
from multilica.sinks.run_story import RunStory
from multilica.sinks.slots import shown_radius_m, slot_offsets_m
from multilica.sinks.thinning import sample_points

__all__ = ["above_group", "around_lidar", "around_rig", "beside_lidar", "sampled_cloud", "three_quarter", "up_axis"]

_SAMPLE = 20_000
_FAR_SHARE = 75.0
_RADIUS_LIMITS_M = (6.0, 40.0)
_ASIDE_M = 1.0


def around_lidar(story: RunStory, lidar: str, *, zoom: float = 1.0) -> rrb.EyeControls3D:
    """What one LiDAR saw, in its own frame; the smaller the zoom, the more of what surrounds it."""
    return _around(_extent_of(story, lidar), up_axis(story, lidar), zoom)


def beside_lidar(story: RunStory, lidar: str) -> rrb.EyeControls3D:
    """The same from aside, for a view that is wider than high: the direction in which it looks goes across."""
    centre_m, radius_m = _extent_of(story, lidar)
    up = up_axis(story, lidar)
    ahead, aside = _horizontal(up, centre_m)
    position = centre_m + radius_m * (-0.5 * ahead - 1.3 * aside + 1.1 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def _extent_of(story: RunStory, lidar: str) -> tuple[FloatArray, float]:
    if lidar not in story.clouds:
        return _extent(np.empty((0, 3)))
    if lidar not in story.extents:
        story.extents[lidar] = _extent(sampled_cloud(story, lidar))
    return story.extents[lidar]


def around_rig(story: RunStory) -> rrb.EyeControls3D:
    """What all placed LiDARs saw, in the target's frame."""
    placements = story.result.placements if story.result is not None else ()
    clouds = [
        place.T_target_source.apply(sampled_cloud(story, place.lidar))
        for place in placements
        if place.placed and place.T_target_source is not None
    ]
    target = story.result.target if story.result is not None else ""
    return _around(_extent(np.concatenate([np.empty((0, 3)), *clouds])), up_axis(story, target))


def three_quarter(centre_m: FloatArray, radius_m: float, up: FloatArray) -> rrb.EyeControls3D:
    """From behind, aside and above, so that what lies within the radius fills the view."""
    ahead, aside = _horizontal(up)
    position = centre_m + radius_m * (-1.05 * ahead - 0.55 * aside + 0.95 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def above_group(story: RunStory) -> rrb.EyeControls3D:
    """From above the slot in which the target's group grows, slightly tilted, z up; the others wait beside it."""
    offsets_m = slot_offsets_m(story.snapshot) if story.snapshot is not None else {}
    centre_m = np.array([0.0, offsets_m.get(story.target, 0.0), 0.0])
    radius_m = shown_radius_m(sampled_cloud(story, story.target))
    position = centre_m + 2.0 * radius_m * np.array([-0.7, 0.0, 0.9])
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=(0.0, 0.0, 1.0))


def sampled_cloud(story: RunStory, lidar: str) -> FloatArray:
    """(N, 3) some of a LiDAR's preprocessed points; none before it is preprocessed."""
    if lidar not in story.clouds:
        return np.empty((0, 3))
    return sample_points(story.clouds[lidar].points_m, _SAMPLE).astype(np.float64)


def up_axis(story: RunStory, lidar: str) -> FloatArray:
    """(3,) upwards in the LiDAR's frame, as far as it is known: its z axis until its pose and the ground are."""
    up = np.array([0.0, 0.0, 1.0])
    if story.result is None:
        return up
    if story.result.ground is not None:
        up = story.result.ground.normal
    for place in story.result.placements:
        if place.lidar == lidar and place.placed and place.T_target_source is not None:
            return np.asarray(place.T_target_source.rotation.T @ up)
    return np.array([0.0, 0.0, 1.0])


def _extent(points_m: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of a cloud (N, 3), as far as it is dense.

    For a LiDAR that looks one way the centre is between its cloud and the sensor.
    """
    if len(points_m) == 0:
        return np.zeros(3), _RADIUS_LIMITS_M[0]
    centre_m = 0.6 * np.median(points_m, axis=0)
    radius_m = np.percentile(np.linalg.norm(points_m - centre_m, axis=1), _FAR_SHARE)
    return centre_m, float(np.clip(radius_m, *_RADIUS_LIMITS_M))


def _around(extent: tuple[FloatArray, float], up: FloatArray, zoom: float = 1.0) -> rrb.EyeControls3D:
    centre_m, radius_m = extent
    return three_quarter(centre_m, radius_m / zoom, up)


def _horizontal(up: FloatArray, towards_m: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Ahead and left of it, both level.

    Args:
        towards_m: (3,) what lies ahead; x does, unless that is nearly up, where it is not given or close to the sensor.
    """
    axis = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    if towards_m is not None and np.linalg.norm(np.cross(up, towards_m)) > _ASIDE_M:
        axis = towards_m
    ahead = axis - (axis @ up) * up
    ahead /= np.linalg.norm(ahead)
    return ahead, np.cross(up, ahead)
