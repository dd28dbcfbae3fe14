# SPDX-License-Identifier: Apache-2.0
"""LiDARs prepared for registration with their views at other stops."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.pairs import PreparedLidar
from multilica.registration.movable import find_movable
from multilica.registration.own_body import BodyCells, find_own_body
from multilica.results import DriveView, PairRegistration
from multilica.stages.ground import estimate_level_about_z, find_levels, rotations_of

# Such a share of the margin of log-odds is less than what links that confirm each other add to their evidence.
_WEAKER = 0.5

# A third of 34 planes of simulated LiDARs with a lower score was over 3 deg or 0.3 m off, on a wall or a slope. So were
# few of 281 others, nearly all in fields.
_LEAST_GROUND = 10.0
# The ground under a vehicle differs by less between stops.
_SAME_SLOPE, _SAME_HEIGHT_M = float(np.cos(np.deg2rad(3.0))), 0.3


@dataclass(frozen=True, slots=True, eq=False)
class DriveStop:
    """A stop after its own calibration.

    Args:
        lidars: those with returns in range.
        pairs: the registrations that its poses rest on.
    """

    name: str
    lidars: Mapping[str, PreparedLidar]
    pairs: tuple[PairRegistration, ...]


def levels_of(stops: Sequence[DriveStop], config: CalibrationConfig) -> dict[str, RigidTransform]:
    """Return the pose of each LiDAR over the ground on which most stops agree; none for one on which no two agree.

    A LiDAR that sees little ground at one stop may take a wall or a slope beside the road for it. If that about z does
    not agree, the LiDAR may have another axis up: then that about any axis counts, unless a ceiling agrees as well.
    """
    found: dict[str, RigidTransform] = {}
    for lidar in sorted({name for stop in stops for name in stop.lidars}):
        clouds = [stop.lidars[lidar].cloud.points_m for stop in stops if lidar in stop.lidars]
        about_z = [estimate_level_about_z(lidar, {lidar: points_m}, {}, config, _LEAST_GROUND) for points_m in clouds]
        level = _agreed([[each] for each in about_z if each is not None])
        if level is None:
            level = _agreed([find_levels(lidar, {lidar: points_m}, {}, config, _LEAST_GROUND) for points_m in clouds])
        if level is not None:
            found[lidar] = level
    return found


def _agreed(at_stops: Sequence[Sequence[RigidTransform]]) -> RigidTransform | None:
    """Return the level on which most stops agree, at least two.

    None if as many agree on another one, or if two agree on one that lies opposite.
    """
    levels = [level for found in at_stops for level in found]
    counts = [sum(any(_is_same_ground(one, other) for other in found) for found in at_stops) for one in levels]
    if max(counts, default=0) < 2:
        return None
    best = levels[int(np.argmax(counts))]
    rivals = [
        level
        for level, count in zip(levels, counts, strict=True)
        if count == max(counts) or (count > 1 and level.rotation[2] @ best.rotation[2] < -_SAME_SLOPE)
    ]
    return best if all(_is_same_ground(best, each) for each in rivals) else None


def prepare_views(
    stops: Sequence[DriveStop], levels: Mapping[str, RigidTransform], config: CalibrationConfig
) -> dict[DriveView, PreparedLidar]:
    """Prepare the LiDARs of all stops with the limits that hold between stops.

    The vehicle's own body, which is in the same place of a LiDAR's frame at every stop, is left out.

    Args:
        levels: as `levels_of` finds them.
    """
    found: dict[DriveView, PreparedLidar] = {}
    limits = _limits(stops, config)
    for lidar in sorted({name for stop in stops for name in stop.lidars}):
        at_stops = {stop.name: stop.lidars[lidar] for stop in stops if lidar in stop.lidars}
        clouds = [each.cloud.points_m for each in at_stops.values()]
        known = _levels_of(lidar, clouds[0], levels, config)
        # The ground is in the same place at every stop: without a vertical, it would be taken for the vehicle.
        body = find_own_body(clouds, [level.rotation for level in known]) if known else BodyCells.none()
        for stop, prepared in at_stops.items():
            view = DriveView(lidar, stop)
            found[view] = _without_body(prepared, body).as_view(view.label, limits)
    return found


def with_movable(
    views: Mapping[DriveView, PreparedLidar], levels: Mapping[str, RigidTransform]
) -> dict[DriveView, PreparedLidar]:
    """Return the views that see objects of the size of vehicles and people, which may have left or come.

    Beams through such objects prove nothing then. More poses are possible, the wrong ones among them.
    """
    found: dict[DriveView, PreparedLidar] = {}
    for name, prepared in views.items():
        if prepared.view is None:
            continue
        points_m = prepared.cloud.points_m
        rotations = rotations_of(_levels_of(name.lidar, points_m, levels, prepared.config))
        movable = find_movable(points_m, np.zeros((1, 3)), rotations).contain(prepared.view.probes_m)
        if movable.any():
            found[name] = prepared.with_view(replace(prepared.view, movable=movable))
    return found


def least_evidence(config: CalibrationConfig) -> float:
    """Return the evidence that a link needs where others tell its pose."""
    return config.acceptance.min_evidence - _WEAKER * config.acceptance.min_log_odds_margin


def _is_same_ground(one: RigidTransform, other: RigidTransform) -> bool:
    """Return whether the ground under a LiDAR has the same slope and height in its frame."""
    cosine, rise_m = float(one.rotation[2] @ other.rotation[2]), float(one.xyz_m[2] - other.xyz_m[2])
    return cosine > _SAME_SLOPE and abs(rise_m) < _SAME_HEIGHT_M


def _levels_of(
    lidar: str, points_m: FloatArray, levels: Mapping[str, RigidTransform], config: CalibrationConfig
) -> list[RigidTransform]:
    """Return the pose of a LiDAR in a frame with z up on which its stops agree, or those that may be right."""
    return [levels[lidar]] if lidar in levels else find_levels(lidar, {lidar: points_m}, {}, config)


def _without_body(prepared: PreparedLidar, body: BodyCells) -> PreparedLidar:
    """Leave the vehicle's own body out of a LiDAR's points, descriptors and probes."""
    if not len(body.keys):
        return prepared
    cloud, features, view = prepared.cloud, prepared.features, prepared.view
    kept = ~body.contain(cloud.points_m)
    described = ~body.contain(features.points_m)
    features = replace(
        features,
        points_m=features.points_m[described],
        normals=features.normals[described],
        descriptors=features.descriptors[described],
    )
    if view is not None:
        probed = ~body.contain(view.probes_m)
        view = replace(
            view,
            probes_m=view.probes_m[probed],
            solid=view.solid[probed],
            normals=view.normals[probed],
            spanned=view.spanned[probed],
        )
    return PreparedLidar(replace(cloud, points_m=cloud.points_m[kept]), features, view, prepared.config)


def _limits(stops: Sequence[DriveStop], config: CalibrationConfig) -> CalibrationConfig:
    """Return the configuration with the limits of links, also of weak ones, and with the sigmas of all views."""
    limits = {"max_baseline_m": config.drive.max_distance_m, "min_evidence": least_evidence(config)}
    acceptance = config.acceptance.model_copy(update=limits)
    sigmas_m = config.refine.range_bias_sigmas_m
    of_views = {
        DriveView(name, stop.name).label: sigmas_m[name] for stop in stops for name in stop.lidars if name in sigmas_m
    }
    refine = config.refine.model_copy(update={"range_bias_sigmas_m": of_views | sigmas_m})
    return config.model_copy(update={"acceptance": acceptance, "refine": refine})
