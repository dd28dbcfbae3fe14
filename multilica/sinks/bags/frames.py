# SPDX-License-Identifier: Apache-2.0
"""Frames of a snapshot in the order of a recording."""

from collections.abc import Iterator

from multilica.snapshot import LidarScans, Scan, Snapshot


def frames_in_order(snapshot: Snapshot) -> Iterator[tuple[LidarScans, Scan]]:
    """Yield each frame with its LiDAR, by stamp, then by name of the LiDAR."""
    frames = [(lidar, scan) for lidar in snapshot.lidars for scan in lidar.scans]
    yield from sorted(frames, key=lambda frame: frame[1].stamp_ns)


def topic_of(lidar: LidarScans) -> str:
    """Return the topic of a LiDAR; a file has none."""
    return lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points"
