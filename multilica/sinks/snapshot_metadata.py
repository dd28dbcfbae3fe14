# SPDX-License-Identifier: Apache-2.0
"""What a snapshot file says about where it comes from."""

from __future__ import annotations

import json

import multilica
from multilica.config import IngestConfig
from multilica.snapshot import Snapshot

__all__ = ["snapshot_metadata", "window_metadata"]


def snapshot_metadata(snapshot: Snapshot) -> dict[str, str]:
    """What is known of every snapshot."""
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
    """What was asked for when it was taken."""
    window = {
        "frames": str(config.frames),
        "start_s": f"{config.start_s:g}",
        "start_at": config.start_at,
        "window": config.window,
        "window_s": f"{config.window_s:g}",
    }
    return window | ({"vehicle": vehicle} if vehicle else {})
