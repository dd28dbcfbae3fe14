# SPDX-License-Identifier: Apache-2.0
"""Height, roll and pitch that the ground in sight of two LiDARs tells of their pose."""

from collections.abc import Mapping

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
    found: list[ViewPair] = []
    for source in others:
        of_target = levels[target]
        along = np.outer(of_target.rotation[2], of_target.rotation[2])
        information = np.zeros((6, 6))
        information[:3, :3] = (np.eye(3) - along) / _GROUND_RAD**2
        information[3:, 3:] = along / _GROUND_M**2
        pose, unknown = of_target.inverse() @ levels[source], float("nan")
        pair = PairRegistration(
            target, source, pose, unknown, unknown, 0, None, None, "", information=information, verdict=_NO_VERDICT
        )
        found.append(ViewPair(pair, "", ""))
    return found


def vertical_of(ground: ViewPair) -> FloatArray:
    """Return the vertical (3,) of such a pair along the axes of its target, of either sign."""
    information = ground.registration.information
    assert information is not None  # noqa: S101
    return np.asarray(np.linalg.eigh(information[3:, 3:])[1][:, -1])
