# SPDX-License-Identifier: Apache-2.0
"""Systematic errors that a registration estimates, of a LiDAR and of each of its rings."""

from dataclasses import dataclass

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, lengths
from multilica.results import IndexArray

BIAS_COUNT = 4
"""Per LiDAR: range (m), elevation and azimuth (rad), and the scale of the ranges."""
RING_BIAS_COUNT = 3
"""Per ring, on top of those of its LiDAR: range (m), elevation and azimuth (rad)."""

# Rings that are closer count as one.
_RING_DEG = 1.0
# A ring's range is off by as much as its LiDAR's; the angles of a LiDAR are the mean of those of 16 rings or more.
_OF_A_RING = np.array([1.0, 4.0, 4.0])

# The biases of a rig are this share of what its datasheets allow: nothing to all of it, each value as likely.
_SHARES = np.array([0.03, 0.1, 0.2, 0.35, 0.6, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class BiasPosterior:
    """Normal approximation of poses and biases after a prior.

    Args:
        step: (6 P + B,) from the state at which the information was computed.
        covariance: of the poses (6 P, 6 P), with the biases marginalised.
        repeatability: (6 P, 6 P) the part of it that random errors cause.
        bias_sigmas: of the first biases, as many as asked for.
    """

    step: FloatArray
    covariance: FloatArray
    repeatability: FloatArray
    bias_sigmas: FloatArray


def shifts_per_bias(points_m: FloatArray) -> FloatArray:
    """Return (4, N, 3) by how much each point (N, 3) in the LiDAR's frame is off per unit of each bias.

    Those of the range shift a point along its beam, those of angles across it: upwards, and to the left. The azimuth
    bias of a LiDAR that sees all around is a rotation about its axis, which no scene can tell from its pose.
    """
    range_m = np.maximum(lengths(points_m), 1e-9)
    flat_m = np.maximum(np.hypot(points_m[:, 0], points_m[:, 1]), 1e-9)
    up = np.column_stack([-points_m[:, :2] * (points_m[:, 2] / flat_m)[:, None], flat_m])
    left = np.column_stack([-points_m[:, 1], points_m[:, 0], np.zeros(len(points_m))])
    return np.stack([points_m / range_m[:, None], up, left, points_m])


def prior_sigmas(lidar: str, config: RefineConfig) -> FloatArray:
    """Return the standard deviations (4,) that the datasheet allows."""
    range_m = config.range_bias_sigmas_m.get(lidar, config.range_bias_sigma_m)
    angles = np.deg2rad([config.elevation_bias_sigma_deg, config.azimuth_bias_sigma_deg])
    return np.array([range_m, *angles, config.range_scale_sigma])


def ring_sigmas(bias_sigmas: FloatArray, rings: int) -> FloatArray:
    """Return the standard deviations (3 R,) of the biases of the rings of a LiDAR with `prior_sigmas` (4,)."""
    return np.tile(_OF_A_RING * bias_sigmas[:RING_BIAS_COUNT], rings)


def ring_numbers(points_m: FloatArray) -> IndexArray:
    """Return the band of elevation (N,) of each point (N, 3) in the LiDAR's frame, from 0."""
    elevation_rad = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    return np.asarray((np.rad2deg(elevation_rad) + 90.0) / _RING_DEG, dtype=np.int64)


def posterior(
    information: FloatArray,
    gradient: FloatArray,
    biases: FloatArray,
    sigmas: FloatArray,
    spread: FloatArray | None = None,
    random_spread: FloatArray | None = None,
    shown: int = 0,
) -> BiasPosterior:
    """Combine what the data say about poses and biases with the prior of the biases.

    The biases have zero mean and the standard deviations `sigmas`, times a share that all have in common and that is
    uniform from 0 to 1: LiDARs that agree to a millimetre are better than their datasheets. The share is integrated
    out on a grid, by the marginal likelihood of the data (empirical Bayes; Bishop, Pattern Recognition and Machine
    Learning, 2006, section 3.5). The covariance is a sandwich (White, Econometrica 1980), with the prior as a
    measurement.

    Args:
        information, gradient: (N, N) and (N,) of the negative log likelihood: poses first, the last B are the biases.
        biases: (B,) at which they were computed.
        sigmas: (B,).
        spread: (N, N) covariance of the gradient; None: equal to the information.
        random_spread: (N, N) the part of it that random errors cause; None: all of it.
        shown: number of biases of which the standard deviations are asked for.
    """
    poses = len(gradient) - len(biases)
    mixed = information[:poses, poses:]
    inverse = np.linalg.pinv(information[:poses, :poses], hermitian=True)
    slope = inverse @ mixed
    reduced = information[poses:, poses:] - mixed.T @ slope
    pull = reduced @ biases - (gradient[poses:] - slope.T @ gradient[:poses])
    values, directions = np.linalg.eigh(reduced * np.outer(sigmas, sigmas))
    values = np.maximum(values, 0.0)
    mean, variances = _mixture(values, directions.T @ (sigmas * pull))
    to_biases, from_biases = sigmas[:, None] * directions, directions / sigmas[:, None]
    change = to_biases @ mean - biases
    step = np.concatenate([-inverse @ (gradient[:poses] + mixed @ change), change])
    slopes = slope @ to_biases
    of_poses = np.hstack([inverse + (slopes * variances) @ slopes.T, -(slopes * variances) @ to_biases.T])
    of_biases = to_biases[:shown] * variances
    bread = np.vstack([of_poses, np.hstack([-of_biases @ slopes.T, of_biases @ to_biases.T])])
    # The prior is a measurement of the principal biases.
    by_prior = bread[:, poses:] @ from_biases * np.sqrt(np.maximum(1.0 / variances - values, 0.0))
    spread = information if spread is None else spread
    full = bread @ spread @ bread.T + by_prior @ by_prior.T
    repeated = full[:poses, :poses] if random_spread is None else of_poses @ random_spread @ of_poses.T
    bias_sigmas = np.minimum(np.sqrt(np.diag(full)[poses:]), sigmas[:shown])
    return BiasPosterior(step, full[:poses, :poses], repeated, bias_sigmas)


def _mixture(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance (B,) over all shares of the prior of biases that are independent, in its sigmas."""
    edges = np.concatenate([[0.0], 0.5 * (_SHARES[1:] + _SHARES[:-1]), [1.0]])
    precisions = _SHARES[:, None] ** -2.0
    variances = 1.0 / (information + precisions)
    means = variances * pull
    log_weights = np.log(np.diff(edges)) + 0.5 * np.sum(np.log(precisions * variances) + pull * means, axis=1)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    mean = weights @ means
    return mean, weights @ (variances + (means - mean) ** 2)
