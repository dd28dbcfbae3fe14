# SPDX-License-Identifier: Apache-2.0
"""LiDARs that were knocked between two stops of a drive."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.multi_snapshot.view_solution import ViewSolution, solve_near
from multilica.results import DriveView, Knock, ViewPair

# A knock explains this much of chi squared with 6 more unknowns, and by an F test, which does not depend on the size of
# the covariances, it is less probable than this by chance.
_LEAST_CHI_SQUARED = 25.0
_PROBABILITY = 1e-5
# A motion may have happened if chance explains the best one of fewer than one drive in twenty as well.
_LEAST_CHANCE = 0.05
_FREEDOM = 6
# A smaller motion cannot be told from systematic errors, rad and m.
_LEAST_RAD, _LEAST_M = float(np.deg2rad(0.1)), 0.005
# Chi squared of odds of a hundred: another time that explains less than this below the best one may be the right one.
_LIKELIER = 9.2
# A LiDAR that seems to move farther on its vehicle did not: the place looks like another one.
MOST_RAD, MOST_M = float(np.deg2rad(30.0)), 0.5
_AFTER = "\0after"
_AS_ARCS = np.repeat([LEVER_ARM_M, 1.0], 3)


@dataclass(frozen=True, slots=True, eq=False)
class PossibleKnock:
    """A motion of a LiDAR between two stops that is not certain enough to be named as a knock.

    Args:
        offsets: per LiDAR (6,) of its pose from that without the motion, rotation (rad), translation (m), along the
            axes of the root.
    """

    lidar: str
    before: str
    after: str
    distance_m: float
    offsets: Mapping[str, FloatArray]

    def widened(self, lidar: str, covariance: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) of a LiDAR that covers its poses with the motion and without."""
        offset = self.offsets.get(lidar)
        return covariance if offset is None else covariance + np.outer(offset, offset)

    def matters(self, lidar: str, covariance: FloatArray) -> bool:
        """Return whether the motion moves a LiDAR by more than its standard deviation."""
        offset = self.offsets.get(lidar)
        return offset is not None and float(offset @ np.linalg.solve(covariance, offset)) > 1.0

    @property
    def text(self) -> str:
        """The motion for people."""
        return (
            f"{self.lidar} may have moved by {1e3 * self.distance_m:.0f} mm between {self.before} and {self.after}, "
            "which sigma covers"
        )


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
        for each in _motions(root, solution, stops)
        if each.probability <= _PROBABILITY and each.explained >= _LEAST_CHI_SQUARED and each.may_be_knock
    ]
    most = max((each.explained for each in found), default=0.0)
    likely = [each for each in found if each.explained > most - _LIKELIER]
    told = [each for each in likely if each.is_told]
    if not told or {each.lidar for each in told} < {each.lidar for each in likely}:
        return None
    best = max(told, key=lambda each: (round(each.explained, 3), each.lidar != root))
    numbers = [
        each.number for each in found if each.lidar == best.lidar and each.explained > best.explained - _LIKELIER
    ]
    earlier, between, later = stops[: min(numbers)], stops[min(numbers) : max(numbers)], stops[max(numbers) :]
    fewer = earlier if len(earlier) <= len(later) else later
    angle_deg = float(np.rad2deg(best.angle_rad))
    left_out = tuple(sorted({*fewer, *between}))
    rivals = tuple(sorted({each.lidar for each in likely} - {best.lidar}))
    return Knock(best.lidar, earlier[-1], later[0], best.distance_m, angle_deg, left_out, rivals)


def find_possible_knock(root: str, solution: ViewSolution, stops: Sequence[str]) -> PossibleKnock | None:
    """Find the motion that explains most, if that is not enough to name it and too much for chance.

    Args:
        solution: of a drive without a knock that `find_knock` names.
    """
    tested = list(_motions(root, solution, stops))
    found = [each for each in tested if each.may_be_knock]
    if not found:
        return None
    best = min(found, key=lambda each: each.probability)
    if best.probability * len(tested) > _LEAST_CHANCE:
        return None
    before, after = stops[best.number - 1], stops[best.number]
    return PossibleKnock(best.lidar, before, after, best.distance_m, best.offsets(root, solution))


@dataclass(frozen=True, slots=True)
class _Motion:
    """A motion of a LiDAR before the stop of that number.

    Args:
        explained: chi squared that it explains.
        probability: of as much by chance.
        apart: the poses with the LiDAR as two, before and after the motion.
    """

    number: int
    lidar: str
    explained: float
    probability: float
    distance_m: float
    angle_rad: float
    apart: ViewSolution

    @property
    def is_told(self) -> bool:
        """True if no single view or pair explains it as well.

        Two pairs or more tell the pose of the LiDAR on either side: alone, one may just be wrong. At one stop only, its
        pairs share the errors of its view there: if these are half of the variance of each of n pairs, these are worth
        2 n / (n + 1) that share none.
        """
        for name in (self.lidar, self.lidar + _AFTER):
            views = [view for pair in self.apart.pairs for view in pair.views if view.lidar == name]
            worth = 2.0 / (len(views) + 1) if len({*views}) == 1 else 1.0
            if len(views) < 2 or self.explained * worth < _LEAST_CHI_SQUARED:
                return False
        return True

    @property
    def may_be_knock(self) -> bool:
        """True if it is too large for an error and too small for another place."""
        is_error = self.distance_m < _LEAST_M and self.angle_rad < _LEAST_RAD
        return not is_error and self.distance_m < MOST_M and self.angle_rad < MOST_RAD

    def offsets(self, root: str, solution: ViewSolution) -> dict[str, FloatArray]:
        """Return per LiDAR (6,) of its pose before or after the motion, the farther one, from that without it."""
        known, poses = solution.poses.poses, self.apart.poses.poses
        found = {}
        for name in solution.poses.free:
            moved = []
            for now in (self.lidar, self.lidar + _AFTER):
                of_root, of_name = (poses[now if each == self.lidar else each] for each in (root, name))
                pose = RigidTransform(root, name, (of_root.inverse() @ of_name).matrix)
                moved.append(pose.offset_from(known[name]))
            found[name] = max(moved, key=lambda offset: float(np.linalg.norm(offset * _AS_ARCS)))
        return found


def _motions(root: str, solution: ViewSolution, stops: Sequence[str]) -> Iterator[_Motion]:
    """Test each LiDAR before each stop but the first."""
    for lidar in sorted(solution.poses.poses):
        for number in range(1, len(stops)):
            found = _moved_at(number, lidar, root, solution, stops)
            if found is not None:
                yield found


def _moved_at(number: int, lidar: str, root: str, solution: ViewSolution, stops: Sequence[str]) -> _Motion | None:
    """Return the motion of a LiDAR before a stop that explains most; None if nothing can tell one."""
    later = {*stops[number:]}
    split = [_renamed(pair, lidar, later) for pair in solution.pairs]
    names = {lidar, lidar + _AFTER}
    if not names <= {view.lidar for pair in split for view in pair.views}:
        return None
    start = RigidTransform(root, lidar + _AFTER, solution.poses.poses[lidar].matrix)
    apart = solve_near(solution, split, {start.source: start})
    explained = solution.squared - apart.squared
    left = _FREEDOM * len(apart.pairs) - apart.poses.columns
    if left <= 0 or explained <= 0.0:
        return None
    probability = float(fdtrc(_FREEDOM, left, explained / _FREEDOM * left / apart.squared))
    before, after = (apart.poses.poses[name] for name in (lidar, lidar + _AFTER))
    distance_m, angle_rad = before.distance_to(RigidTransform(root, lidar, after.matrix))
    return _Motion(number, lidar, explained, probability, distance_m, angle_rad, apart)


def _renamed(pair: ViewPair, lidar: str, later: set[str]) -> ViewPair:
    """Take a LiDAR at later stops for another one."""
    target, source = (_name(view, lidar, later) for view in (pair.target, pair.source))
    pose = RigidTransform(target, source, pair.registration.T_target_source.matrix)
    own = replace(pair.registration, target=target, source=source, T_target_source=pose)
    return replace(pair, registration=own)


def _name(view: DriveView, lidar: str, later: set[str]) -> str:
    return view.lidar + _AFTER if view.lidar == lidar and view.stop in later else view.lidar
