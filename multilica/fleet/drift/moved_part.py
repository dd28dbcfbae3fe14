# SPDX-License-Identifier: Apache-2.0
"""Decision whether a LiDAR moved, or the target against which it is placed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from multilica.fleet.drift.findings import MovedPart
from multilica.geometry import FloatArray, skew

# A common motion fits worse in one of a thousand cases.
_LEAST_P_VALUE = 1e-3
# One of two explanations is ninety times likelier than the other.
_DECIDING = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A LiDAR's change in the frame of the target.

    Args:
        xyz_m: (3,) position before it.
        offset: (6,) rotation (rad), translation (m) along the target's axes.
        covariance: (6, 6) of the offset.
    """

    xyz_m: FloatArray
    offset: FloatArray
    covariance: FloatArray


def find_moved_part(seen: Mapping[str, Seen], changed: Collection[str]) -> tuple[MovedPart, FloatArray]:
    """Decide between the LiDARs that changed significantly and the target.

    If the target moves by D, each ``T_target_lidar`` becomes ``D^-1 T_target_lidar``: one motion of six numbers has to
    explain all LiDARs, also those whose own change is not significant. The covariances are taken as independent.

    Args:
        seen: every LiDAR of the vehicle with logs before and after.
        changed: those that changed significantly.

    Returns:
        The part that moved, and the target's motion (6,) along its own axes before it, as of a LiDAR.
    """
    normal, right = np.zeros((6, 6)), np.zeros(6)
    jacobians = {name: _by_target(each.xyz_m) for name, each in seen.items()}
    for name, each in seen.items():
        weighted = np.linalg.solve(each.covariance, jacobians[name]).T
        normal += weighted @ jacobians[name]
        right += weighted @ each.offset
    common = np.asarray(np.linalg.solve(normal, right))
    if len(seen) < 2:
        return "lidar or target", common
    as_target = sum(_squared(each, jacobians[name] @ common) for name, each in seen.items())
    as_lidars = sum(_squared(each, np.zeros(6)) for name, each in seen.items() if name not in changed)
    if chi2.sf(as_target, 6 * (len(seen) - 1)) < _LEAST_P_VALUE:
        return "lidar", common
    if len(changed) > 1 or as_target < as_lidars - _DECIDING:
        return "target", common
    return "lidar" if as_lidars < as_target - _DECIDING else "lidar or target", common


def _by_target(xyz_m: FloatArray) -> FloatArray:
    """Return the derivative (6, 6) of a LiDAR's offset by the motion of the target along the target's axes."""
    return np.block([[-np.eye(3), np.zeros((3, 3))], [skew(xyz_m), -np.eye(3)]])


def _squared(seen: Seen, expected: FloatArray) -> float:
    left = seen.offset - expected
    return float(left @ np.linalg.solve(seen.covariance, left))
