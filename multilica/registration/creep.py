# SPDX-License-Identifier: Apache-2.0
"""Extrapolation of a registration that creeps in one direction, as GICP does along a tunnel."""

from __future__ import annotations

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.poses import moved

# Cosine between two motions that have the same direction.
_SAME_DIRECTION = 0.9
# Longest leap, in lengths of the last motion.
_LONGEST_LEAP = 10.0


class Creep:
    """Motions of a registration, and where they lead.

    Anderson acceleration over one earlier motion, as Pavlov et al. (AA-ICP, ICRA 2018) use it for ICP, for motions in
    nearly the same direction only. Motions are (6,), rotation vectors times `LEVER_ARM_M` and shifts, in metres.
    """

    def __init__(self) -> None:
        self._began: RigidTransform | None = None
        self._last = np.zeros(6)

    def leap(self, before: RigidTransform, after: RigidTransform, longest_m: float) -> RigidTransform:
        """Add a motion, and return where the next one should begin: after this one, or farther ahead if it creeps."""
        began, last, motion = self._began, self._last, _motion(before, after)
        self._began, self._last = before, motion
        size_m = float(np.linalg.norm(motion))
        if began is None or last @ motion <= _SAME_DIRECTION * float(np.linalg.norm(last)) * size_m:
            return after
        leap = _rest_of_way(motion, motion - last, _motion(began, before))
        shorter = min(1.0, min(longest_m, _LONGEST_LEAP * size_m) / float(np.linalg.norm(leap)))
        return moved(after, shorter * leap[:3] / LEVER_ARM_M, shorter * leap[3:])


def _motion(before: RigidTransform, after: RigidTransform) -> FloatArray:
    return np.asarray(after.offset_from(before) * np.repeat([LEVER_ARM_M, 1.0], 3))


def _rest_of_way(motion: FloatArray, change: FloatArray, way: FloatArray) -> FloatArray:
    """Return the way from the end of a motion to where motions vanish; a very long one if they do not shrink.

    Args:
        change: of the motion against the last one.
        way: from the begin of the last motion to that of this one.
    """
    shrinking = -float(motion @ change)
    if shrinking > 0.0:
        leap = shrinking / float(change @ change) * (way + change)
        if leap @ motion > 0.0:
            return leap
    return motion * _LONGEST_LEAP
