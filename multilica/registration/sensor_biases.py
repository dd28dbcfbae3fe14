# SPDX-License-Identifier: Apache-2.0
"""Systematic errors that a registration estimates, of a LiDAR and of each of its rings."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, lengths
from multilica.results import IndexArray

BIAS_COUNT = 4
"""Per LiDAR: range (m), elevation (rad), the scale of the ranges, and range on a surface that the beam grazes (m)."""
RING_BIAS_COUNT = 3
"""Per ring, on top of those of its LiDAR: range (m), elevation and azimuth (rad)."""
SCALE = 2
"""Place of the scale among the biases of a LiDAR."""

# Rings that are closer count as one.
_RING_DEG = 1.0
# The elevation of a LiDAR is the mean of up to 64 rings.
_RING_ANGLE = 8.0

# The mean of all azimuths defines the frame of a LiDAR, so it is no bias. Pairs do not see all rings: the variance of
# the mean of those that they see is a thirty-first of that of independent ones. With a thirteenth, the yaw's sigma
# over several snapshots was a third larger than the errors of simulated vehicles.
_MEAN_AZIMUTH = 30.0
# The biases of a rig are this share of what its datasheets allow: nothing to all of it, each value as likely.
_SHARES = np.array([0.03, 0.1, 0.2, 0.35, 0.6, 1.0])
# A rig has few LiDARs, which show little of the share of what their datasheets allow. So much more does the prior of
# their biases add to the variance of a pose, measured on simulated vehicles.
_OF_FEW_LIDARS = 1.5
# Steps of ranges and reflectivities of one scene leave an error of this size: no position is known better from there.
_SCENE_SIGMA_M = 0.0007
# The shares depend on each other; further sweeps change sigma by less than a hundredth.
_SWEEPS = 3
# The unknowns of a pose that are lengths.
_POSITION = np.repeat([0.0, 1.0], 3)
# Largest bias by its standard deviation, of 84 LiDARs with the errors that datasheets allow.
_USUAL_BIAS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class BiasPrior:
    """Knowledge of biases before the data, with the shares of the datasheets' sigmas that the data suggest.

    Args:
        information: (B, B).
        uncertain: (B, B) covariance of its pull, because the shares are uncertain.
    """

    information: FloatArray
    uncertain: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BiasPosterior:
    """Normal approximation of poses and biases after a prior.

    Args:
        step: (6 P + B,) from the state at which the information was computed.
        covariance: of the poses (6 P, 6 P), with the biases marginalised.
        repeatability: (6 P, 6 P) the part of it that random errors cause.
        bias_sigmas: of the biases of LiDARs.
        prior: that was used.
    """

    step: FloatArray
    covariance: FloatArray
    repeatability: FloatArray
    bias_sigmas: FloatArray
    prior: BiasPrior


def shifts_per_bias(points_m: FloatArray, normals: FloatArray, axis: FloatArray) -> FloatArray:
    """Return (4, N, 3) by how much each point is off per unit of each bias of its LiDAR.

    An azimuth bias is none of them: it rotates the LiDAR's frame, and the pose is that of the frame in which the points
    are given.

    Args:
        points_m, normals: (N, 3) in the LiDAR's frame.
        axis: (3,) from which its elevations are counted.
    """
    beams = _beams(points_m)
    glancing = 1.0 - np.abs(np.einsum("ij,ij->i", beams, normals))
    return np.stack([beams, _upwards(points_m, axis), points_m, beams * glancing[:, None]])


def slopes_per_bias(points_m: FloatArray, normals: FloatArray, axis: FloatArray) -> FloatArray:
    """Return (N, 4) how far the shifts of `shifts_per_bias` go along the normals."""
    range_m = np.maximum(lengths(points_m), 1e-9)
    along_m = np.einsum("ij,ij->i", points_m, normals)
    cosine = along_m / range_m
    height_m = points_m @ axis
    # The upward direction is the axis less its part along the beam, times the range by the flat range.
    upwards_m = (normals @ axis * range_m - height_m * cosine) * range_m / _flat_m(range_m, height_m)
    return np.column_stack([cosine, upwards_m, along_m, cosine * (1.0 - np.abs(cosine))])


def shifts_per_ring_bias(points_m: FloatArray, axis: FloatArray) -> FloatArray:
    """Return (3, N, 3) by how much each point (N, 3) in the LiDAR's frame is off per unit of each bias of its ring."""
    return np.stack([_beams(points_m), _upwards(points_m, axis), np.cross(axis, points_m)])


def _beams(points_m: FloatArray) -> FloatArray:
    return np.asarray(points_m / np.maximum(lengths(points_m), 1e-9)[:, None])


def _upwards(points_m: FloatArray, axis: FloatArray) -> FloatArray:
    """Return how a point moves per radian of elevation."""
    range_m, height_m = lengths(points_m), points_m @ axis
    flat_m = _flat_m(range_m, height_m)
    return np.asarray(np.outer(range_m**2 / flat_m, axis) - points_m * (height_m / flat_m)[:, None])


def _flat_m(range_m: FloatArray, height_m: FloatArray) -> FloatArray:
    """Return the distances (N,) from the axis."""
    return np.sqrt(np.maximum(range_m**2 - height_m**2, 1e-18))


def prior_sigmas(lidar: str, config: RefineConfig) -> FloatArray:
    """Return the standard deviations (4,) that the datasheet allows."""
    return np.array(config.bias_sigmas(lidar))


def distrust(biases: FloatArray, sigmas: FloatArray) -> float:
    """Return the factor by which the standard deviation of a pose grows if a LiDAR's biases (4,) are unusual.

    They point to an error that the model lacks, such as ranges that a driver scales wrongly, and the pose may be off by
    a part of it.

    Args:
        sigmas: (4,) as `prior_sigmas`.
    """
    return max(1.0, float(np.max(np.abs(biases) / sigmas)) / _USUAL_BIAS)


def distrust_of_chains(root: str, own: Mapping[str, float], pairs: Sequence[Collection[str]]) -> dict[str, float]:
    """Return `distrust` of each LiDAR with those on its way to the root, on the way that is trusted most.

    Args:
        own: per LiDAR.
        pairs: LiDARs of each pair.
    """
    ways = [each for pair in sorted({tuple(sorted(pair)) for pair in pairs}) for each in permutations(pair, 2)]
    found, before = {root: own[root]}, dict[str, float]()
    while found != before:
        before = found.copy()
        for here, there in ways:
            if here in found:
                found[there] = min(found.get(there, np.inf), max(found[here], own[there]))
    return found


def ring_sigmas(bias_sigmas: FloatArray, rings: int) -> FloatArray:
    """Return the standard deviations (3 R,) of the biases of the rings of a LiDAR with `prior_sigmas` (4,).

    The range of a ring is as accurate as that of its LiDAR.
    """
    range_m, elevation, *_ = bias_sigmas
    return np.tile([range_m, _RING_ANGLE * elevation, _RING_ANGLE * elevation], rings)


def ring_numbers(points_m: FloatArray, axis: FloatArray) -> IndexArray:
    """Return the band of elevation (N,) of each point (N, 3) in the LiDAR's frame, from 0."""
    height_m = points_m @ axis
    elevation_rad = np.arctan2(height_m, _flat_m(lengths(points_m), height_m))
    return np.asarray((np.rad2deg(elevation_rad) + 90.0) / _RING_DEG, dtype=np.int64)


def posterior(
    information: FloatArray,
    gradient: FloatArray,
    biases: FloatArray,
    sigmas: FloatArray,
    spread: FloatArray | None = None,
    random_spread: FloatArray | None = None,
    rings: Sequence[int] = (),
    prior: BiasPrior | None = None,
    begin: BiasPrior | None = None,
    scenes: Sequence[int] = (),
) -> BiasPosterior:
    """Combine what the data say about poses and biases with the prior of the biases.

    The biases have zero mean and the standard deviations `sigmas`, times a share that is uniform from 0 to 1. Those of
    one kind have it in common: LiDARs that agree to a millimetre are better than their datasheets. The rings of each
    LiDAR have two shares of their own, one for ranges and one for angles, and their mean azimuth is nearly zero. The
    shares are integrated out on a grid, by the marginal likelihood of the data (empirical Bayes; Bishop, Pattern
    Recognition and Machine Learning, 2006, section 3.5). The covariance is a sandwich (White, Econometrica 1980), with
    the prior as a measurement.

    Args:
        information, gradient: (N, N) and (N,) of the negative log likelihood: poses first, the last B are the biases.
        biases: (B,) at which they were computed.
        sigmas: (B,).
        spread: (N, N) covariance of the gradient; None: equal to the information.
        random_spread: (N, N) the part of it that random errors cause; None: all of it.
        rings: number of rings of each LiDAR, in the order in which their biases end the others.
        prior: of an earlier step; None: found from these data.
        begin: prior of an earlier step, where the search for that of these data begins.
        scenes: that show each pose of six unknowns; empty: one.
    """
    size, poses = len(gradient), len(gradient) - len(biases)
    shown = size - RING_BIAS_COUNT * sum(rings)
    if prior is None:
        prior = _prior_of_all(information, gradient, biases, sigmas, rings, begin)
    solved = _solved_with(prior, information, np.column_stack([-_pulled(gradient, biases, prior), np.eye(size, shown)]))
    bread = solved[:, 1:].T
    of_biases = bread[:, poses:]
    full = bread @ (information if spread is None else spread) @ bread.T
    full += of_biases @ (prior.information + prior.uncertain) @ of_biases.T
    repeated = full if random_spread is None else bread @ random_spread @ bread.T
    of_scenes = np.resize(_POSITION, poses) / (np.repeat(scenes, len(_POSITION)) if scenes else 1.0)
    covariance = full[:poses, :poses] + _SCENE_SIGMA_M**2 * np.diag(of_scenes)
    bias_sigmas = np.minimum(np.sqrt(np.diag(full)[poses:]), sigmas[: shown - poses])
    return BiasPosterior(solved[:, 0], covariance, repeated[:poses, :poses], bias_sigmas, prior)


def posterior_step(
    information: FloatArray,
    gradient: FloatArray,
    biases: FloatArray,
    sigmas: FloatArray,
    rings: Sequence[int] = (),
    prior: BiasPrior | None = None,
) -> tuple[FloatArray, BiasPrior]:
    """Return the step (N,) of `posterior` and its prior; without the covariance, this takes less time."""
    if prior is None:
        prior = _prior_of_all(information, gradient, biases, sigmas, rings, None)
    return _solved_with(prior, information, -_pulled(gradient, biases, prior)), prior


def _pulled(gradient: FloatArray, biases: FloatArray, prior: BiasPrior) -> FloatArray:
    """Add the pull of the prior to the gradient."""
    pulled = gradient.copy()
    pulled[len(gradient) - len(biases) :] += prior.information @ biases
    return pulled


def _solved_with(prior: BiasPrior, information: FloatArray, right: FloatArray) -> FloatArray:
    """Solve the equations (N, N) with the prior of the biases for one or more right sides (N,) or (N, M)."""
    total = information.copy()
    poses = len(information) - len(prior.information)
    total[poses:, poses:] += prior.information
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-12))
    total *= scale[:, None]
    total *= scale
    of_rows = scale if right.ndim == 1 else scale[:, None]
    return of_rows * _solved(total, of_rows * right)


def _groups(biases: int, rings: Sequence[int]) -> tuple[list[IndexArray], list[IndexArray]]:
    """Return which biases have a share of the prior in common: each kind of LiDARs; ranges, then angles of rings."""
    start = biases - RING_BIAS_COUNT * sum(rings)
    of_lidars = [np.arange(start)[kind::BIAS_COUNT] for kind in range(BIAS_COUNT)]
    of_rings = []
    for count in filter(None, rings):
        own = start + np.arange(RING_BIAS_COUNT * count)
        is_range = np.arange(len(own)) % RING_BIAS_COUNT == 0
        of_rings += [own[is_range], own[~is_range]]
        start += len(own)
    return [group for group in of_lidars if len(group)], of_rings


def _prior_of_all(
    information: FloatArray,
    gradient: FloatArray,
    biases: FloatArray,
    sigmas: FloatArray,
    rings: Sequence[int],
    begin: BiasPrior | None,
) -> BiasPrior:
    """Return the prior of all groups of biases.

    The share of each group is sought with the prior that the others have, at first all of what datasheets allow, or the
    prior of an earlier step.
    """
    prior = np.diag(sigmas**-2.0) if begin is None else begin.information.copy()
    uncertain = np.zeros((len(biases), len(biases)))
    if not len(biases):
        return BiasPrior(prior, uncertain)
    reduced, pull = _without_poses(information, gradient, len(biases))
    pull = reduced @ biases - pull
    of_lidars, of_rings = _groups(len(biases), rings)
    for _ in range(_SWEEPS if begin is None else 1):
        covariance = _inverted(reduced + prior)
        means = covariance @ pull
        for group in (*of_lidars, *of_rings):
            block = np.ix_(group, group)
            own = _inverted(covariance[block])
            prior[block], uncertain[block] = _prior(own - prior[block], own @ means[group], sigmas[group])
        del covariance  # two of them take too much memory
    for group in of_lidars:
        block = np.ix_(group, group)
        uncertain[block] += _OF_FEW_LIDARS * (prior[block] + uncertain[block])
    for angles in of_rings[1::2]:
        azimuths = angles[1::2]
        prior[np.ix_(azimuths, azimuths)] += _MEAN_AZIMUTH * np.diag(prior)[azimuths].mean() / len(azimuths)
    return BiasPrior(prior, uncertain)


def _without_poses(information: FloatArray, gradient: FloatArray, biases: int) -> tuple[FloatArray, FloatArray]:
    """Marginalise the poses."""
    poses = len(gradient) - biases
    mixed, own = information[:poses, poses:], information[:poses, :poses]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-12))
    known = scale[:, None] * _solved(
        own * np.outer(scale, scale), scale[:, None] * np.column_stack([mixed, gradient[:poses]])
    )
    return information[poses:, poses:] - mixed.T @ known[:, :-1], gradient[poses:] - mixed.T @ known[:, -1]


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve equations (N, M) of a covariance or an information with ones on its diagonal.

    SciPy's functions for it take longer than LAPACK.
    """
    _, solution, not_positive = dposv(matrix, right)
    return np.asarray(np.linalg.pinv(matrix, hermitian=True) @ right if not_positive else solution)


def _inverted(matrix: FloatArray) -> FloatArray:
    """Invert a covariance or an information (N, N) in its own memory."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    matrix *= scale[:, None]
    matrix *= scale
    factor, not_positive = dpotrf(matrix.T, clean=0)
    if not_positive:
        matrix[:] = np.linalg.pinv(matrix, hermitian=True)
    else:
        upper, _ = dpotri(factor, overwrite_c=1)
        matrix[:] = upper.T
        for row in range(1, len(matrix)):
            matrix[:row, row] = matrix[row, :row]
    matrix *= scale[:, None]
    matrix *= scale
    return matrix


def _prior(information: FloatArray, pull: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the information (B, B) of the prior of biases that have a share in common, and what is uncertain about it.

    Their principal directions by the data, in their sigmas, count as independent.
    """
    values, directions = np.linalg.eigh(information * np.outer(sigmas, sigmas))
    values = np.maximum(values, 0.0)
    variances, apart = _mixture(values, directions.T @ (sigmas * pull))
    precisions = np.maximum(1.0 / variances - values, 0.0)
    axes = directions / sigmas[:, None]
    return (axes * precisions) @ axes.T, (axes * (apart / variances**2)) @ axes.T


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
