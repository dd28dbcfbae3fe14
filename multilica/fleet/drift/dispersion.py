# SPDX-License-Identifier: Apache-2.0
"""True scatter of poses between logs, which differs from their reported covariances.

A covariance counts the systematic errors of the sensors. The biases of a vehicle's LiDARs are the same in all its logs;
the surfaces differ from place to place. Logs of one place therefore scatter by less than reported, and logs of places
with more errors than the model knows by more. The scatter is measured on differences of successive logs (von Neumann
et al., Ann. Math. Stat. 12, 1941), which a jump enters once and a creep hardly at all, with an estimator that a few
large ones do not bend. It is a matrix and not a number, because a scene errs in other directions than the model. Errors
that neighbouring logs share (the same depot for weeks) do not show in these differences; `ScatteredPoses.shared` allows
for them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from multilica.fleet.lidar_series import IndexArray, LidarSeries
from multilica.geometry import FloatArray

PRIOR_LOGS = 12.0
"""Logs that the prior knowledge of a scatter is worth: the fleet's is right for a vehicle to about 30 %."""

# A singular covariance has an inverse with it, in square metres.
_RIDGE = 1e-12 * np.eye(6)
_PLACES_SHARE = 0.75
"""Share of the reported variance by which the poses of one vehicle differ between places; measured on simulated ones.

The rest comes from biases that are the same in all places.
"""
_PRIOR_RATIO_LOGS = 4.0
"""Logs that a scatter as reported is worth, beside what is measured."""
_MEDIAN = float(chdtri(6, 0.5))
# A log that differs from both neighbours by so much is wrong itself; a jump differs from one of them only.
_CONTRADICTED = float(chdtri(6, 0.01))
_T_DOF = 4.0
# Among fewer logs, chance makes the differences of successive ones by far the larger too often.
_MIN_CREEP_LOGS = 8
_CREEP_RATIO = 0.4
_MEAN_SHARES = (0.0, 0.25, 0.5, 0.75, 0.9)
# A rounding error decides nothing.
_BETTER = 1e-6
_ITERATIONS = 30
# Differences of successive logs share a log: they are worth two thirds of independent ones.
_WORTH = 2.0 / 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredPoses:
    """A series as numbers, with the scatter that it really has.

    Args:
        offsets_m: (N, 6) from the reference pose, rotations as lengths.
        covariances: (N, 6, 6) in square metres.
        dof: degrees of freedom with which the scale of the covariances is known.
        shared: (6, 6) covariance of the error that all logs of a period may share (depot, season), which no number of
            logs reduces: what the covariances lack of the difference between places.
        constant: (6, 6) the same of the error that all logs of the vehicle may share: what they lack of the reported
            covariance.
    """

    series: LidarSeries
    offsets_m: FloatArray
    covariances: FloatArray
    dof: float
    shared: FloatArray
    constant: FloatArray


def calibrate_scatter(series: Sequence[LidarSeries]) -> list[ScatteredPoses]:
    """Estimate the true covariances of the logs that report one, pooled over a fleet per LiDAR and target.

    The scale of each single series is drawn towards the fleet's, with `PRIOR_LOGS` as its weight, as in the moderated
    tests of Smyth (Stat. Appl. Genet. Mol. Biol. 3, 2004). Logs that both neighbours contradict lose their weight.
    """
    series = [known for each in series if len(known := each.with_known_covariances())]
    pools: dict[tuple[str, str], list[int]] = defaultdict(list)
    for index, each in enumerate(series):
        pools[each.lidar, each.target].append(index)
    found: dict[int, ScatteredPoses] = {}
    for members in pools.values():
        offsets = [series[i].offsets(series[i].T_target_lidar[len(series[i]) // 2]) for i in members]
        reported = [series[i].scaled_covariances() + _RIDGE for i in members]
        steps = [_Steps.of(series[i].time_ns, *values) for i, *values in zip(members, offsets, reported, strict=True)]
        pooled = _pooled(steps, reported)
        for i, offset, step, told, covariance in zip(members, offsets, steps, reported, pooled, strict=True):
            own = _squared(step.whitened(covariance))
            count = len(own)
            ratio = (PRIOR_LOGS + (np.median(own) / _MEDIAN * count if count else 0.0)) / (PRIOR_LOGS + count)
            scaled = max(1.0, float(ratio)) * covariance
            lacking = [_lacking(_mean(told), _mean(scaled), share) for share in (_PLACES_SHARE, 1.0)]
            scaled = scaled * _contradiction(series[i].time_ns, offset, scaled)[:, None, None]
            found[i] = ScatteredPoses(series[i], offset, scaled, PRIOR_LOGS + _WORTH * count, *lacking)
    return [found[i] for i in range(len(series))]


def _mean(covariances: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of as much information as those (N, 6, 6) have on average."""
    return np.asarray(np.linalg.inv(np.mean(np.linalg.inv(covariances), axis=0)))


def _lacking(reported: FloatArray, scatter: FloatArray, share: float) -> FloatArray:
    """Return the covariance (6, 6) that `scatter` lacks of the reported one times a share, by direction."""
    whiten, root = power_of(reported, -0.5), power_of(reported, 0.5)
    values, vectors = np.linalg.eigh(whiten @ scatter @ whiten)
    return np.asarray(root @ (vectors * np.maximum(share - values, 0.0)) @ vectors.T @ root)


def _pooled(steps: list[_Steps], reported: list[FloatArray]) -> list[FloatArray]:
    """Return the covariances that explain the differences of successive logs best, per series.

    If the errors of scenes prevail, all logs scatter alike, whatever their covariances: the covariances are blended
    with their mean by the share of greatest likelihood.
    """
    mean = _mean(np.concatenate(reported))
    best: tuple[float, list[FloatArray]] = (-np.inf, reported)
    for share in _MEAN_SHARES:
        blended = [(1.0 - share) * each + share * mean for each in reported]
        excess = robust_scatter(
            np.concatenate([step.whitened(each) for step, each in zip(steps, blended, strict=True)])
        )
        roots = [power_of(each, 0.5) for each in blended]
        widened = [root @ excess @ root for root in roots]
        likelihood = sum(step.log_likelihood(each) for step, each in zip(steps, widened, strict=True))
        if likelihood > best[0] + _BETTER:
            best = likelihood, widened
    return best[1]


def robust_scatter(whitened: FloatArray) -> FloatArray:
    """Estimate the covariance (6, 6) of whitened vectors (N, 6), drawn towards the identity.

    The shape is that of a multivariate t distribution (Kent & Tyler, Ann. Stat. 19, 1991), the scale that of the median
    length.
    """
    count = len(whitened)
    shape = np.eye(6)
    for _ in range(_ITERATIONS if count else 0):
        squared = np.einsum("ni,ij,nj->n", whitened, np.linalg.inv(shape), whitened)
        scale = max(float(np.median(squared)) / _MEDIAN, 1e-9)
        weights = (_T_DOF + 6.0) / (_T_DOF + squared / scale)
        total = np.einsum("n,ni,nj->ij", weights / scale, whitened, whitened)
        shape = (PRIOR_LOGS * np.eye(6) + total) / (PRIOR_LOGS + count)
        shape /= np.linalg.det(shape) ** (1.0 / 6.0)
    squared = np.einsum("ni,ij,nj->n", whitened, np.linalg.inv(shape), whitened)
    measured = count * float(np.median(squared)) / _MEDIAN if count else 0.0
    return np.asarray((_PRIOR_RATIO_LOGS + measured) / (_PRIOR_RATIO_LOGS + count) * shape)


def power_of(matrices: FloatArray, exponent: float) -> FloatArray:
    """Return the symmetric powers (..., 6, 6) of symmetric positive definite matrices."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray((vectors * np.maximum(values, 1e-18)[..., None, :] ** exponent) @ np.swapaxes(vectors, -1, -2))


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Combinations of neighbouring logs that are zero but for noise: `factors` (M, 3) of the logs in `rows` (M, 3)."""

    rows: np.ndarray
    factors: FloatArray
    vectors_m: FloatArray

    @classmethod
    def of(cls, time_ns: IndexArray, offsets_m: FloatArray, covariances: FloatArray) -> _Steps:
        """Take differences of successive logs; of a uniform creep, of each log from the line between its neighbours.

        A creep is taken for one if it makes the former far larger than the latter, which chance hardly does.
        """

        def combined(logs: IndexArray, third: int, factors: FloatArray) -> _Steps:
            rows = np.stack([logs, logs + 1, logs + third], 1)
            return cls(rows, factors, np.einsum("mk,mki->mi", factors, offsets_m[rows]))

        count = len(offsets_m)
        logs = np.arange(max(0, count - 1))
        plain = combined(logs, 0, np.tile([-1.0, 1.0, 0.0], (len(logs), 1)))
        if count < _MIN_CREEP_LOGS:
            return plain
        logs = np.arange(count - 2)
        whole = (time_ns[2:] - time_ns[:-2]).astype(np.float64)
        share = np.divide(time_ns[2:] - time_ns[1:-1], whole, out=np.full(count - 2, 0.5), where=whole > 0.0)
        factors = np.stack([-share, np.ones(count - 2), share - 1.0], 1)
        bent = combined(logs, 2, factors)
        sizes = [float(np.median(_squared(each.whitened(covariances)))) for each in (plain, bent)]
        return bent if sizes[1] < _CREEP_RATIO * sizes[0] else plain

    def spread(self, covariances: FloatArray) -> FloatArray:
        """Return the covariances (M, 6, 6) of the vectors for those (N, 6, 6) of the logs."""
        return np.asarray(np.einsum("mk,mkij->mij", self.factors**2, covariances[self.rows]))

    def whitened(self, covariances: FloatArray) -> FloatArray:
        """Return the vectors (M, 6) with the identity as covariance."""
        return np.asarray(np.einsum("mij,mj->mi", power_of(self.spread(covariances), -0.5), self.vectors_m))

    def log_likelihood(self, covariances: FloatArray) -> float:
        """Return the logarithm of the likelihood, in which jumps and errors count little."""
        volumes = np.linalg.slogdet(self.spread(covariances))[1]
        squared = _squared(self.whitened(covariances))
        return float(-0.5 * np.sum(volumes + (_T_DOF + 6.0) * np.log1p(squared / _T_DOF)))


def _squared(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", vectors, vectors))


def _contradiction(time_ns: IndexArray, offsets_m: FloatArray, covariances: FloatArray) -> FloatArray:
    """Compute the (N,) factors, at least 1, on the covariances of logs that both neighbours contradict.

    The first and the last log have the next two on their only side as neighbours. A log on the line between both is not
    contradicted, or a fast creep would be taken for errors. The factor grows with the fourth power of the distance, so
    that a log that is far off counts for nothing.
    """
    count = len(offsets_m)
    if count < 3:
        return np.ones(count)
    logs = np.arange(count)
    one, other = logs - 1, logs + 1
    one[0], other[-1] = 2, count - 3
    apart = (time_ns[other] - time_ns[one]).astype(np.float64)
    share = np.divide(time_ns[other] - time_ns[logs], apart, out=np.full(count, 0.5), where=apart != 0.0)
    distances = []
    # At both ends the share is outside 0 to 1: there is no line between.
    for of_one in (np.ones(count), np.zeros(count), np.clip(share, 0.0, 1.0)):
        a, b = of_one[:, None], 1.0 - of_one[:, None]
        steps = offsets_m - a * offsets_m[one] - b * offsets_m[other]
        spread = covariances + a[..., None] ** 2 * covariances[one] + b[..., None] ** 2 * covariances[other]
        distances.append(np.einsum("ni,ni->n", steps, np.linalg.solve(spread, steps[..., None])[..., 0]))
    return np.asarray(np.maximum(1.0, np.min(distances, axis=0) / _CONTRADICTED) ** 2)
