# SPDX-License-Identifier: Apache-2.0
"""Doubt from scenes that look the same when turned."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from multilica.acceptance.accept import competing_poses
from multilica.config import AcceptanceConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_near
from multilica.results import PairRegistration, Reason, Registration, Verdict
from multilica.visibility.sensor_view import ScorePose

__all__ = ["check_scene_symmetry"]

# A smaller turn is no symmetry of a building; halls and garages have those of 90 and 180 degrees.
_TURNED_RAD = np.deg2rad(45.0)
# The competing pose is not registered: it may be off by centimetres, which puts some points into empty space.
_POSSIBLE_SHARE = 0.01


def check_scene_symmetry(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided if a symmetry of the scene turns them into another possible pose.

    Two LiDARs that face away from each other see no common surface. In a hall with similar ends they still fit each
    other at a pose turned by 180 degrees, and no beam contradicts it. A pair that sees the whole hall finds two poses.
    The motion between these is the symmetry of the hall; it takes the pose of the first two to one that may be correct.

    Returns:
        The pairs in their order, some with another verdict.
    """
    return [_checked(pair, pairs, score_pose, config) if pair.verdict.accepted else pair for pair in pairs]


def _checked(
    pair: PairRegistration, pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> PairRegistration:
    pose = pair.T_target_source
    for other in pairs:
        for lidar in sorted(pair.lidars & other.lidars):
            for symmetry in _symmetries(other, lidar, config):
                turned = symmetry @ pose if lidar == pair.target else pose @ symmetry
                if not is_near(turned, config.max_baseline_m):
                    continue
                competing = score_pose(turned)
                if competing.visibility.violation_share <= _POSSIBLE_SHARE:
                    return replace(pair, verdict=Verdict("undecided", (_reason(pose, competing, other),)))
    return pair


def _symmetries(pair: PairRegistration, lidar: str, config: AcceptanceConfig) -> Iterator[RigidTransform]:
    """Yield motions of the scene, in the frame of a LiDAR of the pair, after which it looks the same to both."""
    best = pair.T_target_source
    for other in competing_poses(pair.registrations, config):
        if best.distance_to(other.T_target_source)[1] >= _TURNED_RAD:
            if lidar == pair.target:
                yield other.T_target_source @ best.inverse()
            else:
                yield best.inverse() @ other.T_target_source


def _reason(pose: RigidTransform, competing: Registration, seen_by: PairRegistration) -> Reason:
    metres, radians = pose.distance_to(competing.T_target_source)
    text = (
        f"{seen_by.target} and {seen_by.source} see a scene that looks the same when turned by "
        f"{np.rad2deg(radians):.0f} deg; the pose {metres:.2f} m away that follows is possible as well"
    )
    return Reason("ambiguous", 1.0, 0.0, text, competing)
