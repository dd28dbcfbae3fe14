# SPDX-License-Identifier: Apache-2.0
"""What the scatter over snapshots tells of a pose's covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.joint.estimate import Estimate
from multilica.results import Spread

__all__ = ["scatter_ratio", "spread_of", "widened"]


def spread_of(estimates: Sequence[Estimate]) -> Spread:
    """Sample standard deviations of one LiDAR's poses in several snapshots."""
    if len(estimates) < 2:
        return Spread(len(estimates))
    sigma = np.std(_offsets(estimates, estimates[0].pose), axis=0, ddof=1)
    return Spread(len(estimates), sigma[3:], np.rad2deg(sigma[:3]))


def scatter_ratio(estimates: Sequence[Estimate]) -> FloatArray:
    """(6,) by how much the poses scatter more than their own covariances predict; 1 where they do not.

    Per axis Birge's ratio (Phys. Rev. 40, 1932): the square root of chi squared per degree of freedom about the
    weighted mean. The standard error of the mean, widened by it, is that of the measured scatter; unlike the plain
    standard error it lets a snapshot that holds the pose badly scatter as far as it says it may.
    """
    if len(estimates) < 2:
        return np.ones(6)
    offsets = _offsets(estimates, estimates[0].pose)
    weights = 1.0 / np.array([np.diag(estimate.covariance) for estimate in estimates])
    mean = np.sum(weights * offsets, axis=0) / np.sum(weights, axis=0)
    chi_squared = np.sum(weights * (offsets - mean) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(1.0, chi_squared / (len(estimates) - 1))))


def widened(covariance: FloatArray, ratio: FloatArray) -> FloatArray:
    """The covariance (6, 6) with each sigma multiplied by its ratio, correlations kept."""
    return np.asarray(covariance * np.outer(ratio, ratio))


def _offsets(estimates: Sequence[Estimate], origin: RigidTransform) -> FloatArray:
    return np.array([estimate.pose.offset_from(origin) for estimate in estimates])
