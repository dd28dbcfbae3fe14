# SPDX-License-Identifier: Apache-2.0
"""Uncertainty ellipsoid of a position."""

import numpy as np

from multilica.geometry import FloatArray, RigidTransform, fixed_sign
from multilica.results import LidarPlacement

__all__ = ["SHOWN_ELLIPSOID_SCALE", "SIGMAS", "uncertainty_ellipsoid"]

SIGMAS = 3.0
"""Half axes, in standard deviations."""

SHOWN_ELLIPSOID_SCALE = 50.0
"""Scale of drawn ellipsoids: millimetres would be invisible."""


def uncertainty_ellipsoid(place: LidarPlacement) -> tuple[FloatArray, RigidTransform] | None:
    """Return half axes (3,) in metres, true to size, with the ellipsoid's pose; None without a covariance."""
    pose = place.T_target_source
    if place.covariance is None or pose is None:
        return None
    variances, axes = np.linalg.eigh(place.covariance[3:, 3:])
    axes = np.apply_along_axis(fixed_sign, 0, axes)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    half_sizes_m = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    return half_sizes_m, RigidTransform.from_rotation_translation(pose.target, pose.source, axes, pose.xyz_m)
