# SPDX-License-Identifier: Apache-2.0
"""The result document of a result: the one conversion of values to what `result.json` holds."""

import math
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import multilica
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import (
    CalibrationResult,
    GroundPlane,
    LidarPlacement,
    PairRegistration,
    SensorHealth,
)
from multilica.results.document.result import (
    RESULT_SCHEMA,
    GroundEntry,
    InputEntry,
    InputLidarEntry,
    LidarEntry,
    PairEntry,
    PriorEntry,
    RegistrationEntry,
    ResultDocument,
)
from multilica.results.prior_comparison import exchanged_names, surprise
from multilica.snapshot import Snapshot

_PACKAGES = {"open3d-cpu": "open3d", "small-gicp": "small_gicp", "kiss-matcher": "kiss_matcher", "rerun-sdk": "rerun"}
_DISTRIBUTIONS = ("numpy", "scipy", "open3d", "open3d-cpu", "small-gicp", "kiss-matcher", "rerun-sdk", "mcap")


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """The origin of a result: runs that share it give the same result; versions are those of installed packages."""

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


def result_document(result: CalibrationResult, config: CalibrationConfig, provenance: Provenance) -> ResultDocument:
    """Convert a result to the document that `result.json` holds."""
    health = {each.lidar: each for each in result.health}
    exchanged = exchanged_names(result.placements, result.target)
    return ResultDocument.of(
        result,
        provenance,
        schema=RESULT_SCHEMA,
        accepted_by="evidence" if config.verify.enabled else "fitness",
        lidars={
            each.lidar: _lidar(each, health.get(each.lidar), result.target, exchanged) for each in result.placements
        },
        pairs=tuple(map(pair_entry, result.pairs)),
        ground=None if result.ground is None else _ground(result.ground),
        config=config,
    )


def _pose(T_target_source: RigidTransform | None) -> dict[str, Any]:
    names = ("xyz_m", "rpy_deg", "quaternion_xyzw")
    matrix = None if T_target_source is None else T_target_source.matrix
    return {"T_target_source": matrix, **{name: getattr(T_target_source, name, None) for name in names}}


def _lidar(
    placement: LidarPlacement, health: SensorHealth | None, target: str, exchanged: tuple[str, str] | None
) -> LidarEntry:
    prior = placement.T_target_source_prior
    return LidarEntry.of(
        placement,
        **_pose(placement.T_target_source),
        prior=None if prior is None else _prior(prior, placement, target, exchanged),
        health=health,
    )


def _prior(
    prior: RigidTransform, placement: LidarPlacement, target: str, exchanged: tuple[str, str] | None
) -> PriorEntry:
    off_m, off_rad = placement.prior_deviation or (math.nan, math.nan)
    off_deg = math.degrees(off_rad)
    text = surprise(placement, target, exchanged)
    return PriorEntry(**_pose(prior), deviation_m=off_m, deviation_deg=off_deg, surprise=text)


def pair_entry(pair: PairRegistration) -> PairEntry:
    """Convert a registered pair to its entry, with the figures that every output shows of it."""
    registrations = [
        RegistrationEntry.of(found.visibility, found, T_target_source=found.T_target_source.matrix)
        for found in pair.registrations
    ]
    return PairEntry.of(pair, **_pose(pair.T_target_source), registrations=registrations)


def _ground(ground: GroundPlane) -> GroundEntry:
    rig = ground.T_base_target_rig
    return GroundEntry.of(
        ground.T_base_target,
        ground,
        T_base_target=ground.T_base_target.matrix,
        T_base_target_rig=None if rig is None else rig.matrix,
    )
