# SPDX-License-Identifier: Apache-2.0
"""Samples of large clouds."""

import numpy as np
import numpy.typing as npt

from multilica.snapshot import Float32Array

__all__ = ["every_nth", "sample_indices", "sample_points"]


def sample_indices(count: int, limit: int) -> npt.NDArray[np.int64]:
    """Return at most `limit` random indices below `count`, in order; the same on every call."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, size=limit, replace=False))


def every_nth(points_m: npt.NDArray[np.floating], enough: int) -> npt.NDArray[np.floating]:
    """Return at least `enough` of the points (N, 3), evenly spaced in order, as a view."""
    return points_m[:: max(1, len(points_m) // enough)]


def sample_points(points_m: npt.NDArray[np.floating], limit: int) -> Float32Array:
    """Return at most `limit` of the points (N, 3), as float32."""
    return np.asarray(points_m[sample_indices(len(points_m), limit)], dtype=np.float32)
