# SPDX-License-Identifier: Apache-2.0
"""Where a result comes from."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import multilica
from multilica.snapshot import LidarScans, Snapshot

__all__ = ["Provenance", "collect_versions", "provenance_of"]

_DISTRIBUTIONS = {
    "numpy": ("numpy",),
    "scipy": ("scipy",),
    "open3d": ("open3d", "open3d-cpu"),
    "small_gicp": ("small-gicp",),
    "kiss_matcher": ("kiss-matcher",),
    "rerun": ("rerun-sdk",),
    "mcap": ("mcap",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """What has to be the same for a result to come out the same.

    Args:
        versions: per package its version; packages that are not installed are left out.
        input: ``source``, ``sha256`` and per LiDAR ``topic``, ``frame_id``, ``frames`` and ``points``.
        platform: operating system and processor.
    """

    versions: Mapping[str, str]
    input: Mapping[str, Any]
    platform: str = ""


def provenance_of(snapshot: Snapshot) -> Provenance:
    """The provenance of what is computed from that snapshot here."""
    lidars = {lidar.name: _lidar_entry(lidar) for lidar in snapshot.lidars}
    source = {"source": snapshot.source, "sha256": snapshot.source_sha256, "lidars": lidars}
    return Provenance(collect_versions(), source, platform.platform())


def _lidar_entry(lidar: LidarScans) -> dict[str, Any]:
    return {
        "topic": lidar.topic,
        "frame_id": lidar.frame_id,
        "frames": len(lidar.scans),
        "points": lidar.points_count,
    }


def collect_versions() -> dict[str, str]:
    """Versions of multilica, of Python and of the packages that a result depends on."""
    versions = {"multilica": multilica.__version__, "python": platform.python_version()}
    for package, distributions in _DISTRIBUTIONS.items():
        found = next((installed for name in distributions if (installed := _installed(name))), None)
        if found is not None:
            versions[package] = found
    return versions


def _installed(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
