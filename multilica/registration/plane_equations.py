# SPDX-License-Identifier: Apache-2.0
"""Sums over the matches of a point-to-plane fit, by its pose, the biases of both LiDARs, and those of their rings."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array

from multilica.geometry import LEVER_ARM_M, FloatArray
from multilica.registration.plane_matches import DISTANCE_M
from multilica.registration.sensor_biases import RING_BIAS_COUNT
from multilica.results import IndexArray

POSE_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)
"""(6,) by which unknowns of a pose are metres, rotations as arcs."""

# Residuals are not taken to be smaller than this.
_MIN_SIGMA_M = 0.005


@dataclass(frozen=True, eq=False)
class PlaneEquations:
    """Derivatives of M residuals by all unknowns of a pair.

    Args:
        jacobian: (M, 14) by the pose and the biases of both LiDARs.
        by_rings: of target and of source, (M, 3) by the biases of the match's ring.
        rings: of target and of source, (M,) index of the ring of each match.
        counts: of target and of source, number of the rings.
    """

    jacobian: FloatArray
    by_rings: tuple[FloatArray, FloatArray]
    rings: tuple[IndexArray, IndexArray]
    counts: tuple[int, int]

    @cached_property
    def _starts(self) -> tuple[int, int, int]:
        """First unknown of the rings of the target and of the source, and the number of unknowns."""
        start, (of_target, of_source) = self.jacobian.shape[1], self.counts
        middle = start + RING_BIAS_COUNT * of_target
        return start, middle, middle + RING_BIAS_COUNT * of_source

    @cached_property
    def _rows(self) -> csr_array:
        """(M, N) derivatives by all unknowns."""
        matches, dense = self.jacobian.shape
        step = np.arange(RING_BIAS_COUNT)
        columns = [np.broadcast_to(np.arange(dense), (matches, dense))]
        values = [self.jacobian]
        for part, rings, start in zip(self.by_rings, self.rings, self._starts, strict=False):
            columns.append(start + RING_BIAS_COUNT * rings[:, None] + step)
            values.append(part)
        filled = dense + 2 * RING_BIAS_COUNT
        return csr_array(
            (np.hstack(values).ravel(), np.hstack(columns).ravel(), filled * np.arange(matches + 1)),
            shape=(matches, self._starts[-1]),
        )

    @cached_property
    def _columns(self) -> csc_array:
        """(M, N) the same by columns."""
        return self._rows.tocsc()

    def summed(self, labels: IndexArray, factors: FloatArray) -> csc_array:
        """Sum the derivatives, times factors (M,), of the matches of each label: (L, N)."""
        return members(labels, factors) @ self._columns

    def changes(self, step: FloatArray) -> FloatArray:
        """Return by how much the residuals (M,) change with the unknowns (N,)."""
        return np.asarray(self._rows @ step)

    def gradient(self, factors: FloatArray) -> FloatArray:
        """Sum the derivatives times factors (M,): (N,)."""
        return np.asarray(factors @ self._rows)

    def hessian(self, weights: FloatArray) -> FloatArray:
        """Sum the outer products of the derivatives (N, N), with weights (M,)."""
        size, dense = self._starts[-1], self.jacobian.shape[1]
        weighted = self.jacobian * weights[:, None]
        total = np.zeros((size, size))
        total[:dense, :dense] = self.jacobian.T @ weighted
        parts = self.by_rings
        blocks = [slice(start, end) for start, end in zip(self._starts, self._starts[1:], strict=False)]
        for part, rings, count, block in zip(parts, self.rings, self.counts, blocks, strict=True):
            sums = _summed_products(rings, count, part, weighted)
            total[block, :dense] = sums.reshape(-1, dense)
            total[:dense, block] = total[block, :dense].T
            own = _summed_products(rings, count, part, part * weights[:, None])
            diagonal = np.zeros((count, RING_BIAS_COUNT, count, RING_BIAS_COUNT))
            diagonal[np.arange(count), :, np.arange(count), :] = own
            total[block, block] = diagonal.reshape(total[block, block].shape)
        both = self.rings[0] * self.counts[1] + self.rings[1]
        between = _summed_products(both, self.counts[0] * self.counts[1], parts[0], parts[1] * weights[:, None])
        between = between.reshape(*self.counts, RING_BIAS_COUNT, RING_BIAS_COUNT).swapaxes(1, 2)
        of_target, of_source = blocks
        total[of_target, of_source] = between.reshape(total[of_target, of_source].shape)
        total[of_source, of_target] = total[of_target, of_source].T
        return total


def _summed_products(labels: IndexArray, count: int, left: FloatArray, right: FloatArray) -> FloatArray:
    """Sum the outer products of rows (M, A) and (M, B) of each label: (count, A, B)."""
    products = (left[:, :, None] * right[:, None, :]).reshape(len(labels), -1)
    found = members(labels, np.ones(len(labels)), count) @ products
    return np.asarray(found).reshape(count, left.shape[1], right.shape[1])


def members(labels: IndexArray, factors: FloatArray, count: int | None = None) -> csc_array:
    """Return the matrix (L, M) that sums the rows of each label, times factors (M,)."""
    matches = len(labels)
    count = int(labels.max()) + 1 if count is None else count
    return csc_array((factors, labels, np.arange(matches + 1)), shape=(count, matches))


def floored(hessian: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H and B with a floor: where H is below one point, one point with the largest match distance counts."""
    hessian, spread = hessian.copy(), spread.copy()
    lengths = np.outer(POSE_SCALE, POSE_SCALE)
    values, directions = np.linalg.eigh(hessian[:6, :6] * lengths)
    loose = directions[:, values < 1.0]
    hessian[:6, :6] += (directions * np.maximum(1.0 - values, 0.0)) @ directions.T / lengths
    spread[:6, :6] += DISTANCE_M**2 * (loose @ loose.T) / lengths
    return hessian, spread


def noise_of(hessian: FloatArray) -> FloatArray:
    """Return the covariance of the sum of scores if all residuals were as small as they can be."""
    return _MIN_SIGMA_M**2 * hessian


def usual_variance(hessian: FloatArray, spread: FloatArray) -> float:
    """Return the variance of a residual with which the Hessian of the pose would be its information, the median of six.

    Weights by direction would follow the chance with which few surfaces agree.
    """
    values, directions = np.linalg.eigh(hessian[:6, :6] * np.outer(POSE_SCALE, POSE_SCALE))
    whitened = POSE_SCALE[:, None] * directions / np.sqrt(np.maximum(values, 1e-9))
    return float(np.median(np.linalg.eigvalsh(whitened.T @ spread[:6, :6] @ whitened)))
