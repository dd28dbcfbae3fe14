# SPDX-License-Identifier: Apache-2.0
"""Versions, input and platform of a result."""

import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import multilica
from multilica.results.document.result import InputEntry, InputLidarEntry
from multilica.snapshot import Snapshot

_PACKAGES = {"open3d-cpu": "open3d", "small-gicp": "small_gicp", "kiss-matcher": "kiss_matcher", "rerun-sdk": "rerun"}
_DISTRIBUTIONS = ("numpy", "scipy", "open3d", "open3d-cpu", "small-gicp", "kiss-matcher", "rerun-sdk", "mcap")


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """What must be the same for two runs to give the same result; versions are those of installed packages."""

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
    source = InputEntry(source=snapshot.source, sha256=snapshot.source_sha256, lidars=lidars, notes=snapshot.notes)
    return Provenance(collect_versions(), source, platform.platform())


def collect_versions() -> dict[str, str]:
    """Return the versions of multilica, of Python and of the packages that a result depends on."""
    versions = {"multilica": multilica.__version__, "python": platform.python_version()}
    for distribution in _DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            versions.setdefault(_PACKAGES.get(distribution, distribution), version(distribution))
    return versions
