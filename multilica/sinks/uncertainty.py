# SPDX-License-Identifier: Apache-2.0
"""The uncertainty of a position as an ellipsoid."""

from __future__ import annotations

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LidarPlacement

__all__ = ["SHOWN_ELLIPSOID_SCALE", "SIGMAS", "uncertainty_ellipsoid"]

SIGMAS = 3.0
"""Half axes, in standard deviations."""

SHOWN_ELLIPSOID_SCALE = 50.0
"""By how much ellipsoids are enlarged where they are drawn: of millimetres nothing would be seen."""


def uncertainty_ellipsoid(place: LidarPlacement) -> tuple[FloatArray, RigidTransform] | None:
    """Half axes (3,) in metres, true to size, with their directions as a rotation at the LiDAR's place.

    None for a LiDAR whose covariance or pose is not known.
    """
    pose = place.T_target_source
    if place.covariance is None or pose is None:
        return None
    variances, axes = np.linalg.eigh(place.covariance[3:, 3:])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    half_sizes_m = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    return half_sizes_m, RigidTransform.from_rotation_translation(pose.target, pose.source, axes, pose.xyz_m)
