# SPDX-License-Identifier: Apache-2.0
"""Places beside each other for LiDARs without a pose."""

import numpy as np
import numpy.typing as npt

from multilica.sinks.drawing.thinning import every_nth
from multilica.snapshot import Float32Array, LidarScans, Snapshot

__all__ = ["raw_points", "shown_radius_m", "slot_offsets_m"]

_RADIUS_SAMPLE = 10_000


def slot_offsets_m(snapshot: Snapshot) -> dict[str, float]:
    """Return offsets along y at which the dense parts of the clouds do not overlap."""
    offsets_m: dict[str, float] = {}
    edge_m = 0.0
    for lidar in snapshot.lidars:
        radius_m = shown_radius_m(raw_points(lidar))
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


def raw_points(lidar: LidarScans) -> Float32Array:
    """Return all returns (N, 3) of a LiDAR in its own frame."""
    scans = [scan.points_m for scan in lidar.scans]
    return np.concatenate(scans) if scans else np.empty((0, 3), dtype=np.float32)
