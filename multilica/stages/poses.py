# SPDX-License-Identifier: Apache-2.0
"""When two poses are the same answer."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from multilica.geometry import RigidTransform

__all__ = ["is_distinct"]

_SAME_POSE_M = 0.3
_SAME_POSE_RAD = float(np.deg2rad(3.0))


def is_distinct(
    pose: RigidTransform,
    others: Iterable[RigidTransform],
    same_m: float = _SAME_POSE_M,
    same_rad: float = _SAME_POSE_RAD,
) -> bool:
    """Whether none of the other poses is the same answer: as near in translation, and in rotation."""
    distances = (pose.distance_to(other) for other in others)
    return all(metres > same_m or radians > same_rad for metres, radians in distances)
