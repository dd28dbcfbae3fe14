# SPDX-License-Identifier: Apache-2.0
"""Versions, input and platform of a result."""

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import multilica
from multilica.results.document import InputEntry, InputLidarEntry
from multilica.snapshot import Snapshot

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
    """What must be the same for two runs to give the same result.

    Args:
        versions: per package its version; packages that are not installed are left out.
        platform: operating system and processor.
    """

    versions: Mapping[str, str]
    input: InputEntry
    platform: str = ""


def provenance_of(snapshot: Snapshot) -> Provenance:
    """Return the provenance of a result that is computed from that snapshot on this machine."""
    lidars = {
        lidar.name: InputLidarEntry(
            topic=lidar.topic, frame_id=lidar.frame_id, frames=len(lidar.scans), points=lidar.points_count
        )
        for lidar in snapshot.lidars
    }
    source = InputEntry(source=snapshot.source, sha256=snapshot.source_sha256, lidars=lidars)
    return Provenance(collect_versions(), source, platform.platform())


def collect_versions() -> dict[str, str]:
    """Return the versions of multilica, of Python and of the packages that a result depends on."""
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
