# SPDX-License-Identifier: Apache-2.0
"""How firmly a registration holds its pose."""

from __future__ import annotations

import numpy as np

from multilica.results import PairRegistration

__all__ = ["ROTATION_SCALE_M", "weakest_curvature"]

ROTATION_SCALE_M = 10.0
"""Lever arm that makes a rotation comparable with a translation."""


def weakest_curvature(registration: PairRegistration) -> float:
    """Smallest eigenvalue of the Hessian per inlier, in units where `ROTATION_SCALE_M` makes a rotation a length."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / ROTATION_SCALE_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])
