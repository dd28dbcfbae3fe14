# SPDX-License-Identifier: Apache-2.0
"""LiDARs prepared for registration with their views at other stops."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.pairs import PreparedLidar
from multilica.registration.movable import find_movable
from multilica.registration.own_body import BodyCells, find_own_body
from multilica.results import DriveView, PairRegistration
from multilica.stages.ground import estimate_level
from multilica.visibility.sensor_view import ROUGH_TOLERANCES, score_pose

# Margins of log-odds against a pose that is a few centimetres off: a handful of points in empty space is none.
_FIRM = 2.0


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


def prepare_views(
    stops: Sequence[DriveStop], config: CalibrationConfig, *, movable: bool
) -> dict[DriveView, PreparedLidar]:
    """Prepare the LiDARs of all stops with the limits that hold between stops.

    The vehicle's own body, which is in the same place of a LiDAR's frame at every stop, is left out. Objects of the
    size of vehicles and people may have left or come.

    Args:
        movable: beams through such objects prove nothing. More poses are then possible, the wrong ones among them.
    """
    found: dict[DriveView, PreparedLidar] = {}
    for lidar in sorted({name for stop in stops for name in stop.lidars}):
        at_stops = {stop.name: stop.lidars[lidar] for stop in stops if lidar in stop.lidars}
        points_m = [each.cloud.points_m for each in at_stops.values()]
        level = estimate_level(lidar, {lidar: points_m[0]}, {}, config)
        rotation = np.eye(3) if level is None else level.rotation
        body = find_own_body(points_m, rotation)
        for stop, prepared in at_stops.items():
            view = DriveView(lidar, stop)
            outside = _without_body(prepared, body)
            chosen = _with_movable(outside, rotation) if movable else outside
            found[view] = chosen.as_view(view.label, _limits(view, config))
    return found


def levels_of(stops: Sequence[DriveStop], config: CalibrationConfig) -> dict[str, RigidTransform]:
    """Return the pose of each LiDAR over the ground that it sees at its first stop, if it sees any."""
    points_m = {name: prepared.cloud.points_m for stop in reversed(stops) for name, prepared in stop.lidars.items()}
    levels = {name: estimate_level(name, {name: points_m[name]}, {}, config) for name in sorted(points_m)}
    return {name: level for name, level in levels.items() if level is not None}


def contradiction_at(
    stops: Sequence[DriveStop], config: CalibrationConfig, pose: RigidTransform, apart_from: Collection[str]
) -> str:
    """Return the first stop at which the beams of two LiDARs contradict their pose on the vehicle; "" if none do.

    Args:
        apart_from: stops that are not tested.
    """
    for stop in stops:
        if stop.name in apart_from:
            continue
        views = [stop.lidars[name].view for name in (pose.target, pose.source) if name in stop.lidars]
        if len(views) == 2 and (target := views[0]) is not None and (source := views[1]) is not None:
            score = score_pose(target, source, pose, *ROUGH_TOLERANCES).visibility
            if score.contradiction > _FIRM * config.acceptance.min_log_odds_margin:
                return stop.name
    return ""


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


def _with_movable(prepared: PreparedLidar, rotation: FloatArray) -> PreparedLidar:
    """Let points on objects that can move violate no beam."""
    view = prepared.view
    if view is None:
        return prepared
    cells = find_movable(prepared.cloud.points_m, np.zeros((1, 3)), rotation)
    return prepared.with_view(replace(view, movable=cells.contain(view.probes_m)))


def _limits(view: DriveView, config: CalibrationConfig) -> CalibrationConfig:
    """Return the configuration with the limit of distance between stops, and with the sigmas of the LiDAR."""
    acceptance = config.acceptance.model_copy(update={"max_baseline_m": config.drive.max_distance_m})
    sigmas_m = config.refine.range_bias_sigmas_m
    own = {view.label: sigmas_m[view.lidar]} if view.lidar in sigmas_m else {}
    refine = config.refine.model_copy(update={"range_bias_sigmas_m": own | sigmas_m})
    return config.model_copy(update={"acceptance": acceptance, "refine": refine})
