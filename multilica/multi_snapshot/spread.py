# SPDX-License-Identifier: Apache-2.0
"""Scatter of a pose over snapshots."""

from collections.abc import Sequence

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.multi_snapshot.estimate import Estimate
from multilica.results import Spread

__all__ = ["scatter_ratio", "spread_of", "widened"]


def spread_of(estimates: Sequence[Estimate]) -> Spread:
    """Compute the sample standard deviations of one LiDAR's poses in several snapshots."""
    if len(estimates) < 2:
        return Spread(len(estimates))
    sigma = np.std(_offsets(estimates, estimates[0].pose), axis=0, ddof=1)
    return Spread(len(estimates), sigma[3:], np.rad2deg(sigma[:3]))


def scatter_ratio(estimates: Sequence[Estimate]) -> FloatArray:
    """Compute the (6,) ratios of the measured scatter to that which the covariances predict, at least 1.

    Per axis Birge's ratio (Phys. Rev. 40, 1932): the square root of chi squared per degree of freedom about the
    weighted mean. The standard error of the mean times this ratio agrees with the measured scatter. Unlike the plain
    standard error it lets a snapshot with a large covariance scatter accordingly.
    """
    if len(estimates) < 2:
        return np.ones(6)
    offsets = _offsets(estimates, estimates[0].pose)
    weights = 1.0 / np.array([np.diag(estimate.covariance) for estimate in estimates])
    mean = np.sum(weights * offsets, axis=0) / np.sum(weights, axis=0)
    chi_squared = np.sum(weights * (offsets - mean) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(1.0, chi_squared / (len(estimates) - 1))))


def widened(covariance: FloatArray, ratio: FloatArray) -> FloatArray:
    """Multiply each sigma of a covariance (6, 6) by its ratio and keep the correlations."""
    return np.asarray(covariance * np.outer(ratio, ratio))


def _offsets(estimates: Sequence[Estimate], origin: RigidTransform) -> FloatArray:
    return np.array([estimate.pose.offset_from(origin) for estimate in estimates])
