# SPDX-License-Identifier: Apache-2.0
"""Checks of links against the motions of LiDARs by odometry, and the poses that only motions tell."""

from collections.abc import Collection, Mapping, Sequence
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
_BLOCKS = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class MotionPose:
    """A pose on the vehicle that motions tell, with its covariance (6, 6) along the axes of the root."""

    T_root_lidar: RigidTransform
    covariance: FloatArray


def agreeing_motions(root: str, within: Sequence[ViewPair], motions: Sequence[ViewPair]) -> list[ViewPair]:
    """Leave out motions that contradict the others, the least probable first: a LiDAR may have followed a lorry."""
    left = [*motions]
    while left:
        solution = solve_views(root, [*within, *left])
        chances = [(_chance(solution, pair), number) for number, pair in enumerate(left) if _is_told(solution, pair)]
        if not chances or min(chances)[0] >= _LEAST_PROBABILITY:
            break
        del left[min(chances)[1]]
    return left


def links_off_course(
    root: str, within: Sequence[ViewPair], links: Sequence[ViewPair], motions: Sequence[ViewPair]
) -> list[ViewPair]:
    """Return the links that are farther from where the motions put them than the errors of both allow."""
    if not motions:
        return []
    solution = solve_views(root, [*within, *motions])
    return [link for link in links if _is_told(solution, link) and _is_elsewhere(solution, link)]


def poses_by_motions(
    root: str, pairs: Sequence[ViewPair], motions: Sequence[ViewPair], known: Collection[str]
) -> Mapping[str, MotionPose]:
    """Return the poses of LiDARs that the pairs leave open and motions tell, as in hand-eye calibration.

    Args:
        pairs: within stops and between them.
        known: LiDARs whose poses the pairs tell.
    """
    if {motion.target.lidar for motion in motions} <= {*known}:
        return {}
    solution = solve_views(root, [*pairs, *motions])
    covariance = solution.covariance
    found: dict[str, MotionPose] = {}
    for number, lidar in enumerate(solution.poses.free):
        if lidar not in known:
            block = slice(6 * number, 6 * number + 6)
            found[lidar] = MotionPose(solution.poses.poses[lidar], covariance[block, block])
    return found


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
