# SPDX-License-Identifier: Apache-2.0
"""Smaller samples of what is too large to show."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from multilica.snapshot import Float32Array

__all__ = ["every_nth", "sample_indices", "sample_points"]


def sample_indices(count: int, limit: int) -> npt.NDArray[np.int64]:
    """At most `limit` of the indices below `count`, spread at random, in order; the same on every call."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, size=limit, replace=False))


def every_nth(points_m: npt.NDArray[np.floating], enough: int) -> npt.NDArray[np.floating]:
    """Of the points (N, 3) at least `enough`, evenly spread over their order: as a view, for figures of the whole."""
    return points_m[:: max(1, len(points_m) // enough)]


def sample_points(points_m: npt.NDArray[np.floating], limit: int) -> Float32Array:
    """At most `limit` of the points (N, 3), as float32."""
    return np.asarray(points_m[sample_indices(len(points_m), limit)], dtype=np.float32)
