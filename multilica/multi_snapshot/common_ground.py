# SPDX-License-Identifier: Apache-2.0
"""Height, roll and pitch that the ground in sight of two LiDARs tells of their pose."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairRegistration, Verdict, ViewPair

# The ground that two LiDARs see is no common plane: by so much it differs in slope and height, with room for kerbs.
_GROUND_RAD, _GROUND_M = float(np.deg2rad(1.0)), 0.1
_NO_VERDICT = Verdict("undecided")


def ground_pairs(levels: Mapping[str, RigidTransform]) -> list[ViewPair]:
    """Return pairs of one LiDAR with each other one that sees ground; they have no weight in the plane.

    Args:
        levels: per LiDAR with ground in sight, its pose over the ground, by height, roll and pitch.
    """
    target, *others = sorted(levels) or [""]
    return [_pair(target, each, levels[target].rotation[2], levels[target].inverse() @ levels[each]) for each in others]


def ground_pairs_of(lidars: Collection[str], grounds: Sequence[ViewPair]) -> list[ViewPair]:
    """Return the pairs between some LiDARs; if the one that all have in common is missing, another takes its part."""
    seen = [each for each in grounds if each.source.lidar in lidars]
    if not seen or grounds[0].target.lidar in lidars:
        return seen
    first, *others = seen
    to_first = first.registration.T_target_source.inverse()
    vertical = to_first.rotation @ vertical_of(first)
    return [
        _pair(first.source.lidar, each.source.lidar, vertical, to_first @ each.registration.T_target_source)
        for each in others
    ]


def _pair(target: str, source: str, vertical: FloatArray, pose: RigidTransform) -> ViewPair:
    """Return the pair of two LiDARs that see the same ground, with its vertical (3,) along the axes of the target."""
    along = np.outer(vertical, vertical)
    information, unknown = np.zeros((6, 6)), float("nan")
    information[:3, :3] = (np.eye(3) - along) / _GROUND_RAD**2
    information[3:, 3:] = along / _GROUND_M**2
    pair = PairRegistration(
        target, source, pose, unknown, unknown, 0, None, None, "", information=information, verdict=_NO_VERDICT
    )
    return ViewPair(pair, "", "")


def vertical_of(ground: ViewPair) -> FloatArray:
    """Return the vertical (3,) of such a pair along the axes of its target, of either sign."""
    information = ground.registration.information
    assert information is not None  # noqa: S101
    return np.asarray(np.linalg.eigh(information[3:, 3:])[1][:, -1])
