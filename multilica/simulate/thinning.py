# SPDX-License-Identifier: Apache-2.0
"""Thinning of snapshots, for smaller files."""

from dataclasses import replace

from multilica.snapshot import LidarScans, Snapshot


def thinned(snapshot: Snapshot, keep_every: int) -> Snapshot:
    """Keep only every Nth return; the first one differs from frame to frame, so that together they cover all beams."""
    return replace(snapshot, lidars=tuple(_thinned(lidar, keep_every) for lidar in snapshot.lidars))


def _thinned(lidar: LidarScans, keep_every: int) -> LidarScans:
    kept = [scan.points_m[index % keep_every :: keep_every] for index, scan in enumerate(lidar.scans)]
    scans = (replace(scan, points_m=points_m) for scan, points_m in zip(lidar.scans, kept, strict=True))
    return replace(lidar, scans=tuple(scans))
