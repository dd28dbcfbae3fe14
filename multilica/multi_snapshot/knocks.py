# SPDX-License-Identifier: Apache-2.0
"""LiDARs that were knocked between two stops of a drive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from multilica.geometry import RigidTransform
from multilica.multi_snapshot.view_solution import ViewSolution, solve_near
from multilica.results import DriveView, Knock, ViewPair

# A knock explains this much of chi squared with 6 more unknowns, and by an F test, which does not depend on the size of
# the covariances, it is less probable than this by chance.
_LEAST_CHI_SQUARED = 25.0
_PROBABILITY = 1e-5
_FREEDOM = 6
# A smaller motion cannot be told from systematic errors, rad and m.
_LEAST_RAD, _LEAST_M = float(np.deg2rad(0.1)), 0.005
# Chi squared of odds of a hundred: another time that explains less than this below the best one may be the right one.
_LIKELIER = 9.2
# A LiDAR that seems to move farther on its vehicle did not: the place looks like another one.
_MOST_RAD, _MOST_M = float(np.deg2rad(30.0)), 0.5
_AFTER = "\0after"


def spares(knock: Knock, pair: ViewPair) -> bool:
    """Return whether a pair has no view of a knocked LiDAR at the stops that are left out."""
    return not any(view.lidar == knock.lidar and view.stop in knock.left_out for view in pair.views)


def find_knock(root: str, solution: ViewSolution, stops: Sequence[str]) -> Knock | None:
    """Find the LiDAR whose motion between two stops explains most of the contradictions; None if none does.

    Stops that may be on either side of the motion are named as being between, and left out: those where the LiDAR has
    no views, for example.

    Args:
        solution: with one pose per LiDAR.
        stops: all stops in the order of the drive.
    """
    if solution.squared < _LEAST_CHI_SQUARED:
        return None
    found = [
        each
        for lidar in sorted(solution.poses.poses)
        for number in range(1, len(stops))
        if (each := _moved_at(number, lidar, root, solution, stops)) is not None
    ]
    if not found:
        return None
    best = max(found, key=lambda each: (round(each.explained, 3), each.lidar != root))
    numbers = [
        each.number for each in found if each.lidar == best.lidar and each.explained > best.explained - _LIKELIER
    ]
    earlier, between, later = stops[: min(numbers)], stops[min(numbers) : max(numbers)], stops[max(numbers) :]
    fewer = earlier if len(earlier) <= len(later) else later
    angle_deg = float(np.rad2deg(best.angle_rad))
    return Knock(best.lidar, earlier[-1], later[0], best.distance_m, angle_deg, tuple(sorted({*fewer, *between})))


@dataclass(frozen=True, slots=True)
class _Motion:
    """A motion of a LiDAR before the stop of that number, with the chi squared that it explains."""

    number: int
    lidar: str
    explained: float
    distance_m: float
    angle_rad: float


def _moved_at(number: int, lidar: str, root: str, solution: ViewSolution, stops: Sequence[str]) -> _Motion | None:
    """Return the motion of a LiDAR before a stop; None if none explains much."""
    later = {*stops[number:]}
    split = [_renamed(pair, lidar, later) for pair in solution.pairs]
    names = {lidar, lidar + _AFTER}
    if not names <= {view.lidar for pair in split for view in pair.views}:
        return None
    start = RigidTransform(root, lidar + _AFTER, solution.poses.poses[lidar].matrix)
    apart = solve_near(solution, split, {start.source: start})
    explained = solution.squared - apart.squared
    left = _FREEDOM * len(apart.pairs) - apart.poses.columns
    if left <= 0 or fdtrc(_FREEDOM, left, explained / _FREEDOM * left / apart.squared) > _PROBABILITY:
        return None
    before, after = (apart.poses.poses[name] for name in (lidar, lidar + _AFTER))
    distance_m, angle_rad = before.distance_to(RigidTransform(root, lidar, after.matrix))
    if explained < _LEAST_CHI_SQUARED or not _may_be_knock(distance_m, angle_rad):
        return None
    return _Motion(number, lidar, explained, distance_m, angle_rad)


def _may_be_knock(distance_m: float, angle_rad: float) -> bool:
    """Return whether a motion is too large for an error and too small for another place."""
    is_error = distance_m < _LEAST_M and angle_rad < _LEAST_RAD
    return not is_error and distance_m < _MOST_M and angle_rad < _MOST_RAD


def _renamed(pair: ViewPair, lidar: str, later: set[str]) -> ViewPair:
    """Take a LiDAR at later stops for another one."""
    target, source = (_name(view, lidar, later) for view in (pair.target, pair.source))
    pose = RigidTransform(target, source, pair.registration.T_target_source.matrix)
    own = replace(pair.registration, target=target, source=source, T_target_source=pose)
    return replace(pair, registration=own)


def _name(view: DriveView, lidar: str, later: set[str]) -> str:
    return view.lidar + _AFTER if view.lidar == lidar and view.stop in later else view.lidar
