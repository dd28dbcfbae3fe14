# SPDX-License-Identifier: Apache-2.0
"""Checks of links against the motions of LiDARs by odometry, and the poses that only motions tell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from multilica.geometry import FloatArray, RigidTransform, rotation_angle_rad
from multilica.multi_snapshot.view_solution import ViewSolution, solve_views
from multilica.registration.poses import is_distinct
from multilica.results import StopMotion, ViewPair

_FREEDOM = 6
# A correct link or motion differs as much less often.
_LEAST_PROBABILITY = 1e-6
OPEN_M = 0.5
"""The height that a drive on a plane leaves free has a larger standard deviation."""
# Motions of LiDARs on one vehicle differ by more hardly ever; these are not farther from each other.
_SIGMAS, _APART_M = 4.0, 12.0
# Covariance of the systematic errors of links, which these poses do without.
_SYSTEMATIC = np.diag(np.repeat([np.deg2rad(0.1) ** 2, 0.02**2], 3))
_BLOCKS = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class ToldPose:
    """A pose on the vehicle with its covariance (6, 6) along the axes of the root."""

    T_root_lidar: RigidTransform
    covariance: FloatArray


def agreeing_motions(
    root: str, within: Sequence[ViewPair], motions: Sequence[ViewPair]
) -> tuple[list[ViewPair], ViewSolution | None]:
    """Leave out motions that contradict the others: a LiDAR may have seen too little, or have followed a lorry.

    On one vehicle all LiDARs turn by the same angle, and go as far, but for what their distance makes of the turn.
    Then those go that contradict the others and the pairs, the least probable first.

    Returns:
        The others, and the poses by them and the pairs; None if all go.
    """
    left = [one for one in motions if not _is_odd(one, [each for each in motions if each is not one])]
    while left:
        solution = solve_views(root, [*within, *left])
        chances = [(_chance(solution, pair), number) for number, pair in enumerate(left) if _is_told(solution, pair)]
        if not chances or min(chances)[0] >= _LEAST_PROBABILITY:
            return left, solution
        del left[min(chances)[1]]
    return left, None


def links_off_course(course: ViewSolution | None, links: Sequence[ViewPair]) -> list[ViewPair]:
    """Return the links that are farther from where the motions put them than the errors of both allow.

    Args:
        course: poses by motions and pairs within stops; None: there are no motions.
    """
    if course is None:
        return []
    return [link for link in links if _is_told(course, link) and _is_elsewhere(course, link)]


def poses_by_motions(
    root: str,
    pairs: Sequence[ViewPair],
    motions: Sequence[ViewPair],
    known: Mapping[str, FloatArray],
    grounds: Sequence[ViewPair],
) -> Mapping[str, ToldPose]:
    """Return the poses of LiDARs that the pairs leave open and motions tell, as in hand-eye calibration.

    A drive on a plane leaves the height of a LiDAR free, which the ground that it and others see then tells. So it
    does where links and pairs tell all but the height.

    Args:
        pairs: within stops and between them.
        known: covariances of the poses of LiDARs that the pairs connect.
        grounds: pairs of LiDARs that see the same ground.
    """
    on_ground = {lidar for pair in grounds for lidar in pair.registration.lidars}
    told = {
        lidar
        for lidar, own in known.items()
        if lidar not in on_ground or np.linalg.eigvalsh(own[3:, 3:])[-1] < OPEN_M**2
    }
    moved = {motion.target.lidar for motion in motions} - {root, *known}
    if told == known.keys() and not moved:
        return {}
    solution = solve_views(root, [*pairs, *(motions if moved else ())], grounds)
    covariance = solution.covariance
    blocks = {lidar: slice(6 * number, 6 * number + 6) for number, lidar in enumerate(solution.poses.free)}
    return {
        lidar: ToldPose(solution.poses.poses[lidar], covariance[block, block] + _SYSTEMATIC)
        for lidar, block in blocks.items()
        if lidar not in told
    }


def described(motion: ViewPair, *, used: bool) -> StopMotion:
    """Return a motion for the result."""
    pose = motion.registration.T_target_source
    covariance = np.linalg.inv(np.asarray(motion.registration.information))
    angles, shifts = (float(np.sqrt(np.linalg.eigvalsh(covariance[block, block])[-1])) for block in _BLOCKS)
    return StopMotion(
        motion.target.lidar,
        motion.target_stop,
        motion.source_stop,
        distance_m=float(np.linalg.norm(pose.xyz_m)),
        angle_deg=float(np.rad2deg(rotation_angle_rad(pose.rotation))),
        sigma_m=shifts,
        sigma_deg=float(np.rad2deg(angles)),
        used=used,
    )


def _is_odd(motion: ViewPair, others: Sequence[ViewPair]) -> bool:
    """Return whether more than half of the other motions between the same stops differ in their size."""
    rivals = [
        each for each in others if (each.target_stop, each.source_stop) == (motion.target_stop, motion.source_stop)
    ]
    against = sum(_differ(described(motion, used=True), described(each, used=True)) for each in rivals)
    return 2 * against > len(rivals)


def _differ(one: StopMotion, other: StopMotion) -> bool:
    by_turn_m = 2.0 * _APART_M * float(np.sin(np.deg2rad(0.5 * min(one.angle_deg, other.angle_deg))))
    allowed_deg = _SIGMAS * float(np.hypot(one.sigma_deg, other.sigma_deg))
    allowed_m = _SIGMAS * float(np.hypot(one.sigma_m, other.sigma_m)) + by_turn_m
    return abs(one.angle_deg - other.angle_deg) > allowed_deg or abs(one.distance_m - other.distance_m) > allowed_m


def _is_told(solution: ViewSolution, link: ViewPair) -> bool:
    """Return whether both views of a link have poses in one frame."""
    if not link.registration.lidars <= solution.poses.poses.keys() or not link.stops <= solution.poses.stops.keys():
        return False
    return any(link.stops <= {*group} for group in solution.linked.groups())


def _chance(solution: ViewSolution, pair: ViewPair) -> float:
    offset = solution.poses.offset(pair)
    return float(chdtrc(_FREEDOM, offset @ np.asarray(pair.registration.information) @ offset))


def _is_elsewhere(solution: ViewSolution, link: ViewPair) -> bool:
    poses = solution.poses
    target, source = (poses.pose_of(view, within=False) for view in (link.target, link.source))
    known = link.registration.T_target_source
    implied = RigidTransform(known.target, known.source, (target.inverse() @ source).matrix)
    if not is_distinct(implied, [known]):
        return False
    jacobian, columns = poses.jacobian(link)
    covariance = jacobian @ solution.covariance[np.ix_(columns, columns)] @ jacobian.T
    covariance += np.linalg.inv(np.asarray(link.registration.information))
    offset = poses.offset(link)
    return bool(chdtrc(_FREEDOM, offset @ np.linalg.solve(covariance, offset)) < _LEAST_PROBABILITY)
