# SPDX-License-Identifier: Apache-2.0
"""Systematic errors that a registration estimates, of a LiDAR and of each of its rings."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

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
        bias_sigmas: of the biases of LiDARs.
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
    rings: int = 0,
) -> BiasPosterior:
    """Combine what the data say about poses and biases with the prior of the biases.

    The biases have zero mean and the standard deviations `sigmas`, times a share that all have in common and that is
    uniform from 0 to 1: LiDARs that agree to a millimetre are better than their datasheets. The share is integrated
    out on a grid, by the marginal likelihood of the data (empirical Bayes; Bishop, Pattern Recognition and Machine
    Learning, 2006, section 3.5). Rings have a share of their own: LiDARs with equal rings may still be off. The
    covariance is a sandwich (White, Econometrica 1980), with the prior as a measurement.

    Args:
        information, gradient: (N, N) and (N,) of the negative log likelihood: poses first, the last B are the biases.
        biases: (B,) at which they were computed.
        sigmas: (B,).
        spread: (N, N) covariance of the gradient; None: equal to the information.
        random_spread: (N, N) the part of it that random errors cause; None: all of it.
        rings: number of the last biases that are those of rings.
    """
    size, poses = len(gradient), len(gradient) - len(biases)
    state = np.concatenate([np.zeros(poses), biases])
    of_lidars, of_rings = slice(poses, size - rings), slice(size - rings, size)
    allowed = np.zeros(size)
    allowed[of_lidars] = sigmas[: len(biases) - rings] ** -2.0
    total, pulled, known = information + np.diag(allowed), gradient + allowed * state, np.zeros((size, size))
    if rings:
        # Their share is sought with the biases of the LiDARs as large as they may be.
        prior, known[of_rings, of_rings] = _prior(total, pulled, state, sigmas[len(biases) - rings :], of_rings)
        total[of_rings, of_rings] += prior
        pulled[of_rings] += prior @ state[of_rings]
    total -= np.diag(allowed)
    pulled -= allowed * state
    if of_lidars.start < of_lidars.stop:
        chosen = sigmas[: len(biases) - rings]
        prior, known[of_lidars, of_lidars] = _prior(total, pulled, state, chosen, of_lidars)
        total[of_lidars, of_lidars] += prior
        pulled[of_lidars] += prior @ state[of_lidars]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-12))
    shown = size - rings
    wanted = np.column_stack([-scale * pulled, np.diag(scale)[:, :shown]])
    solved = scale[:, None] * _solved(total * np.outer(scale, scale), wanted)
    bread = solved[:, 1:].T
    full = bread @ ((information if spread is None else spread) + known) @ bread.T
    repeated = full if random_spread is None else bread @ random_spread @ bread.T
    bias_sigmas = np.minimum(np.sqrt(np.diag(full)[poses:]), sigmas[: len(biases) - rings])
    return BiasPosterior(solved[:, 0], full[:poses, :poses], repeated[:poses, :poses], bias_sigmas)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve equations of a covariance or an information with ones on its diagonal."""
    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True) @ right)


def _prior(
    information: FloatArray, gradient: FloatArray, state: FloatArray, sigmas: FloatArray, block: slice
) -> tuple[FloatArray, FloatArray]:
    """Return the information (B, B) of the prior of some unknowns, all others marginalised, and its covariance as data.

    Their principal directions by the data, in their sigmas, count as independent.
    """
    others = np.ones(len(gradient), dtype=bool)
    others[block] = False
    mixed, rest = information[others, block], information[np.ix_(others, others)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(rest), 1e-12))
    known = scale[:, None] * _solved(
        rest * np.outer(scale, scale), scale[:, None] * np.column_stack([mixed, gradient[others]])
    )
    reduced = information[block, block] - mixed.T @ known[:, :-1]
    pull = reduced @ state[block] - (gradient[block] - mixed.T @ known[:, -1])
    values, directions = np.linalg.eigh(reduced * np.outer(sigmas, sigmas))
    values = np.maximum(values, 0.0)
    variances, apart = _mixture(values, directions.T @ (sigmas * pull))
    precisions = np.maximum(1.0 / variances - values, 0.0)
    axes = directions / sigmas[:, None]
    return (axes * precisions) @ axes.T, (axes * (precisions + apart / variances**2)) @ axes.T


def _mixture(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variance (B,) of independent biases over all shares of the prior, and that of their means.

    All is in units of the prior's standard deviations.
    """
    edges = np.concatenate([[0.0], 0.5 * (_SHARES[1:] + _SHARES[:-1]), [1.0]])
    precisions = _SHARES[:, None] ** -2.0
    variances = 1.0 / (information + precisions)
    means = variances * pull
    log_weights = np.log(np.diff(edges)) + 0.5 * np.sum(np.log(precisions * variances) + pull * means, axis=1)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    return weights @ variances, weights @ (means - weights @ means) ** 2
