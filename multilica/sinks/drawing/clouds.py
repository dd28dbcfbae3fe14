# SPDX-License-Identifier: Apache-2.0
"""Samples of clouds with their places beside each other."""

import numpy as np
import numpy.typing as npt

from multilica.geometry import Float32Array
from multilica.snapshot import Snapshot

_RADIUS_SAMPLE = 10_000


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
    shown_m = points_m if len(points_m) <= limit else points_m[sample_indices(len(points_m), limit)]
    return np.asarray(shown_m, dtype=np.float32)


def slot_offsets_m(snapshot: Snapshot) -> dict[str, float]:
    """Return offsets along y at which the dense parts of the clouds do not overlap."""
    offsets_m: dict[str, float] = {}
    edge_m = 0.0
    for lidar in snapshot.lidars:
        radius_m = shown_radius_m(lidar.points_m.astype(np.float32))
        offsets_m[lidar.name] = edge_m - radius_m
        edge_m -= 2.0 * radius_m
    return offsets_m


def shown_radius_m(points_m: npt.NDArray[np.floating]) -> float:
    """Return the radius around the sensor that contains most of a cloud (N, 3)."""
    sample_m = every_nth(points_m, _RADIUS_SAMPLE)
    finite = sample_m[np.all(np.isfinite(sample_m), axis=1)]
    if len(finite) == 0:
        return 5.0
    return float(np.clip(np.percentile(np.linalg.norm(finite[:, :2], axis=1), 75.0), 5.0, 40.0))
