# SPDX-License-Identifier: Apache-2.0
"""Tests of the pose of two LiDARs by their beams at the stops of a drive."""

import math
from collections.abc import Collection, Sequence

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration.stop_views import DriveStop
from multilica.results import Registration
from multilica.visibility.sensor_view import ROUGH_TOLERANCES, score_pose

# Margins of log-odds against a pose that is a few centimetres off: a handful of points in empty space is none.
_FIRM = 2.0


def contradiction_at(
    stops: Sequence[DriveStop], config: CalibrationConfig, pose: RigidTransform, apart_from: Collection[str]
) -> str:
    """Return the first stop at which the beams of two LiDARs contradict their pose on the vehicle; "" if none do.

    Args:
        apart_from: stops that are not tested.
    """
    for stop in stops:
        found = None if stop.name in apart_from else _score(stop, pose)
        if found is not None and found.visibility.contradiction > _FIRM * config.acceptance.min_log_odds_margin:
            return stop.name
    return ""


def lead_at(stops: Sequence[DriveStop], name: str, registered: Registration, pose: RigidTransform) -> float:
    """Return by how much a registered pose of two LiDARs is likelier than another, by their beams at a stop.

    Returns:
        Log-odds; -inf if the stop is none of those, or not both LiDARs have a view there.
    """
    found = next((_score(stop, pose) for stop in stops if stop.name == name), None)
    return -math.inf if found is None else registered.rough_lead_over(found)


def _score(stop: DriveStop, pose: RigidTransform) -> Registration | None:
    """Score a pose of two LiDARs by their beams at a stop; None if not both have a view there."""
    views = [stop.lidars[name].view for name in (pose.target, pose.source) if name in stop.lidars]
    if len(views) < 2 or (target := views[0]) is None or (source := views[1]) is None:
        return None
    return score_pose(target, source, pose, *ROUGH_TOLERANCES)
