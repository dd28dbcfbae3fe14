# SPDX-License-Identifier: Apache-2.0
"""Systematic errors of a LiDAR that a registration estimates: in range and its scale, elevation and azimuth."""

from dataclasses import dataclass

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, lengths

BIAS_COUNT = 4
"""Per LiDAR: range (m), elevation and azimuth (rad), and the scale of the ranges."""

# The biases of a rig are this share of what its datasheets allow: nothing to all of it, each value as likely.
_SHARES = np.array([0.03, 0.1, 0.2, 0.35, 0.6, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class BiasPosterior:
    """Normal approximation of poses and biases after a prior.

    Args:
        step: (6 P + B,) from the state at which the information was computed.
        covariance: of the poses (6 P, 6 P), with the biases marginalised.
        repeatability: (6 P, 6 P) the part of it that random errors cause.
        bias_sigmas: (B,).
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


def posterior(
    information: FloatArray,
    gradient: FloatArray,
    biases: FloatArray,
    sigmas: FloatArray,
    spread: FloatArray | None = None,
    random_spread: FloatArray | None = None,
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
    """
    poses = len(gradient) - len(biases)
    of_poses, mixed = information[:poses, :poses], information[:poses, poses:]
    inverse = np.linalg.pinv(of_poses, hermitian=True)
    reduced = information[poses:, poses:] - mixed.T @ inverse @ mixed
    pull = reduced @ biases - (gradient[poses:] - mixed.T @ inverse @ gradient[:poses])
    mean, covariance = _mixture(reduced, pull, sigmas)
    change = mean - biases
    step = np.concatenate([-inverse @ (gradient[:poses] + mixed @ change), change])
    # By shares of the mixture's covariance: metres and radians do not compare.
    root = np.linalg.cholesky(covariance)
    values, directions = np.linalg.eigh(np.eye(len(root)) - root.T @ reduced @ root)
    directions = np.linalg.solve(root.T, directions)
    prior = np.zeros_like(information)
    prior[poses:, poses:] = (directions * np.maximum(values, 0.0)) @ directions.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information + prior), 1e-12))
    bread = np.linalg.pinv((information + prior) * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    spread = information if spread is None else spread
    full = bread @ (spread + prior) @ bread
    repeated = full if random_spread is None else bread @ random_spread @ bread
    return BiasPosterior(
        step, full[:poses, :poses], repeated[:poses, :poses], np.minimum(np.sqrt(np.diag(full)[poses:]), sigmas)
    )


def _mixture(information: FloatArray, pull: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (B,) and covariance (B, B) of the biases over all shares of the prior."""
    means, covariances, log_weights = [], [], []
    edges = np.concatenate([[0.0], 0.5 * (_SHARES[1:] + _SHARES[:-1]), [1.0]])
    for share, width in zip(_SHARES, np.diff(edges), strict=True):
        prior = np.diag((share * sigmas) ** -2.0)
        covariance = np.linalg.inv(information + prior)
        means.append(covariance @ pull)
        covariances.append(covariance)
        log_determinants = np.linalg.slogdet(prior)[1] + np.linalg.slogdet(covariance)[1]
        log_weights.append(np.log(width) + 0.5 * (log_determinants + pull @ means[-1]))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    apart = np.array(means) - mean
    spread = np.einsum("k,ki,kj->ij", weights, apart, apart)
    return mean, np.asarray(np.tensordot(weights, np.array(covariances), 1) + spread)
