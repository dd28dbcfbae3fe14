# SPDX-License-Identifier: Apache-2.0
"""Motions of LiDARs from stop to stop as weak measurements of the vehicle's way and the poses of its LiDARs."""

from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np

from multilica.geometry import RigidTransform, skew
from multilica.results import PairRegistration, Verdict, ViewPair
from multilica.snapshot import LidarMotion


def motion_pairs(stops: Sequence[tuple[str, Sequence[LidarMotion]]], used: Collection[str]) -> tuple[ViewPair, ...]:
    """Return the motions as pairs of views of consecutive stops.

    Errors of odometry are alike on each way: more of them make the poses no more certain than one.

    Args:
        stops: names in the order of the drive, each with the motions since the previous one.
        used: names of the stops that count; motions over others are chained.
    """
    ways: dict[str, list[tuple[str, str, LidarMotion]]] = {}
    before, since = "", 0
    for number, (name, _) in enumerate(stops):
        if name not in used:
            continue
        legs = [{motion.lidar: motion for motion in motions} for _, motions in stops[since + 1 : number + 1]]
        for lidar in sorted(set.intersection(*(set(leg) for leg in legs))) if before else ():
            ways.setdefault(lidar, []).append((before, name, reduce(_chained, (leg[lidar] for leg in legs))))
        before, since = name, number
    return tuple(_pair(*way, len(own)) for own in ways.values() for way in own)


def _chained(first: LidarMotion, second: LidarMotion) -> LidarMotion:
    rotation = first.T_before_now.rotation
    by_first = np.eye(6)
    by_first[3:, :3] = -skew(rotation @ second.T_before_now.xyz_m)
    by_second = np.kron(np.eye(2), rotation)
    return LidarMotion(
        first.lidar,
        first.T_before_now @ second.T_before_now,
        by_first @ first.covariance @ by_first.T + by_second @ second.covariance @ by_second.T,
        first.way_m + second.way_m,
        first.frames + second.frames,
    )


def _pair(before: str, after: str, motion: LidarMotion, count: int) -> ViewPair:
    information = np.asarray(np.linalg.inv(count * motion.covariance), dtype=np.float64)
    pose = RigidTransform(motion.lidar, motion.lidar, motion.T_before_now.matrix)
    registration = PairRegistration(
        motion.lidar,
        motion.lidar,
        pose,
        fitness=-np.inf,
        rmse_m=float("nan"),
        inliers=0,
        converged=None,
        iterations=None,
        engine="odometry",
        information=information,
        verdict=Verdict("undecided"),
    )
    return ViewPair(registration, before, after)
