# SPDX-License-Identifier: Apache-2.0
"""What a snapshot needs so that it can be calibrated."""

from __future__ import annotations

from multilica.errors import UnfitSnapshotError
from multilica.snapshot import Snapshot

__all__ = ["require_calibratable"]


def require_calibratable(snapshot: Snapshot) -> None:
    """Check that at least two LiDARs have points.

    Raises:
        UnfitSnapshotError: they have not.
    """
    source = snapshot.source or "The snapshot"
    if len(snapshot.lidars) < 2:
        only = f"only one LiDAR ({snapshot.names[0]})" if snapshot.names else "no LiDAR"
        raise UnfitSnapshotError(f"{source} has {only}; calibration needs at least two.")
    blind = [lidar.name for lidar in snapshot.lidars if lidar.points_count == 0]
    seeing = [lidar.name for lidar in snapshot.lidars if lidar.points_count > 0]
    if len(seeing) < 2:
        raise UnfitSnapshotError(
            f"{source} has finite points of {', '.join(seeing) or 'no LiDAR'} only, none of {', '.join(blind)}; "
            "calibration needs at least two LiDARs with points."
        )
