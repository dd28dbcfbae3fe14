# SPDX-License-Identifier: Apache-2.0
"""Metadata of a snapshot file."""

import json

import multilica
from multilica.config import IngestConfig
from multilica.snapshot import Snapshot

__all__ = ["snapshot_metadata", "window_metadata"]


def snapshot_metadata(snapshot: Snapshot) -> dict[str, str]:
    """Return the origin of a snapshot."""
    stamps = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans] or [0]
    return {
        "lidars": ", ".join(snapshot.names),
        "source": snapshot.source,
        "source_sha256": snapshot.source_sha256,
        "first_stamp_ns": str(min(stamps)),
        "last_stamp_ns": str(max(stamps)),
        "notes": json.dumps(snapshot.notes),
        "version": multilica.__version__,
    }


def window_metadata(config: IngestConfig, vehicle: str = "") -> dict[str, str]:
    """Return the options with which a snapshot was taken."""
    window = {
        "frames": str(config.frames),
        "start_s": f"{config.start_s:g}",
        "start_at": config.start_at,
        "window": config.window,
        "window_s": f"{config.window_s:g}",
    }
    return window | ({"vehicle": vehicle} if vehicle else {})
