# SPDX-License-Identifier: Apache-2.0
"""The result document of a result: the one conversion of values to what `result.json` holds, with remarks on priors."""

import math
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import combinations

import numpy as np

import multilica
from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform, largest_index, rotation_angle_rad, rotation_vector
from multilica.results import CalibrationResult, GroundPlane, LidarPlacement, PairRegistration, SensorHealth
from multilica.results.document import (
    RESULT_SCHEMA,
    GroundEntry,
    InputEntry,
    InputLidarEntry,
    LidarEntry,
    PairEntry,
    PriorEntry,
    RegistrationEntry,
    ResultDocument,
    StopEntry,
)
from multilica.snapshot import Snapshot

_PACKAGES = {"open3d-cpu": "open3d", "small-gicp": "small_gicp", "kiss-matcher": "kiss_matcher", "rerun-sdk": "rerun"}
_DISTRIBUTIONS = ("numpy", "scipy", "open3d", "open3d-cpu", "small-gicp", "kiss-matcher", "rerun-sdk", "mcap")

_MOUNT_PLAY_M = 0.3
_MOUNT_PLAY_RAD = float(np.deg2rad(10.0))
_HALF_TURN_RAD = float(np.deg2rad(150.0))
_MAINLY = 0.9
_NO_ANGLE, _NO_DISTANCE = "0 deg", "0.00 m"
_MOUNTED = {"x": "upside down", "y": "upside down", "z": "backwards"}


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


# Packages do not change under a process, and their metadata takes milliseconds to read.
_version = cache(version)


def collect_versions() -> dict[str, str]:
    """Return the versions of multilica, of Python and of the packages that a result depends on."""
    versions = {"multilica": multilica.__version__, "python": platform.python_version()}
    for distribution in _DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            versions.setdefault(_PACKAGES.get(distribution, distribution), _version(distribution))
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
        stops=tuple(
            StopEntry.of(each.T_first_stop, each, T_first_stop=each.T_first_stop.matrix) for each in result.stops
        ),
        ground=None if result.ground is None else _ground(result.ground),
        config=config,
    )


def _lidar(
    placement: LidarPlacement, health: SensorHealth | None, target: str, exchanged: tuple[str, str] | None
) -> LidarEntry:
    pose, prior = placement.T_target_source, placement.T_target_source_prior
    return LidarEntry.of(
        placement,
        T_target_source=None if pose is None else pose.matrix,
        **{name: getattr(pose, name, None) for name in ("xyz_m", "rpy_deg", "quaternion_xyzw")},
        prior=None if prior is None else _prior(prior, placement, target, exchanged),
        health=health,
    )


def _prior(
    prior: RigidTransform, placement: LidarPlacement, target: str, exchanged: tuple[str, str] | None
) -> PriorEntry:
    off_m, off_rad = placement.prior_deviation or (math.nan, math.nan)
    off_deg = math.degrees(off_rad)
    text = surprise(placement, target, exchanged)
    return PriorEntry.of(prior, T_target_source=prior.matrix, deviation_m=off_m, deviation_deg=off_deg, surprise=text)


def pair_entry(pair: PairRegistration) -> PairEntry:
    """Convert a registered pair to its entry, with the figures that every output shows of it."""
    registrations = [
        RegistrationEntry.of(found.visibility, found, T_target_source=found.T_target_source.matrix)
        for found in pair.registrations
    ]
    pose = pair.T_target_source
    return PairEntry.of(pose, pair, T_target_source=pose.matrix, registrations=registrations)


def _ground(ground: GroundPlane) -> GroundEntry:
    rig = ground.T_base_target_rig
    return GroundEntry.of(
        ground.T_base_target,
        ground,
        T_base_target=ground.T_base_target.matrix,
        T_base_target_rig=None if rig is None else rig.matrix,
    )


def surprises(result: CalibrationResult) -> tuple[str, ...]:
    """Describe every LiDAR whose pose differs from its prior by more than the play of a mount."""
    exchanged = exchanged_names(result.placements, result.target)
    found = (surprise(placement, result.target, exchanged) for placement in result.placements)
    return tuple(text for text in found if text)


def exchanged_names(placements: Sequence[LidarPlacement], target: str) -> tuple[str, str] | None:
    """Find two LiDARs with which all poses agree with the prior once their names are exchanged.

    The play of a mount is allowed. If the poses agree as they are named, nothing is exchanged.
    """
    poses = {
        placement.lidar: (placement.T_target_source_prior, placement.T_target_source)
        for placement in placements
        if placement.T_target_source_prior is not None and placement.T_target_source is not None
    }
    if target not in poses or all(_agree(*pose) for pose in poses.values()):
        return None
    for one, other in combinations(poses, 2):
        named = {name: name for name in poses} | {one: other, other: one}
        from_target = poses[named[target]][0].inverse()
        if all(_agree(from_target @ poses[named[name]][0], found) for name, (_, found) in poses.items()):
            return one, other
    return None


def _agree(prior: RigidTransform, found: RigidTransform) -> bool:
    off_m = float(np.linalg.norm(prior.xyz_m - found.xyz_m))
    return off_m <= _MOUNT_PLAY_M and rotation_angle_rad(prior.rotation.T @ found.rotation) <= _MOUNT_PLAY_RAD


def surprise(placement: LidarPlacement, target: str, exchanged: tuple[str, str] | None = None) -> str | None:
    """Describe how a placement differs from its prior, with the likely cause; None if it agrees with the prior.

    Args:
        exchanged: two LiDARs whose exchange explains the difference, as `exchanged_names` finds them.
    """
    deviation, prior, found = placement.prior_deviation, placement.T_target_source_prior, placement.T_target_source
    if deviation is None or prior is None or found is None:
        return None
    off_m, off_rad = deviation
    if off_m <= _MOUNT_PLAY_M and off_rad <= _MOUNT_PLAY_RAD:
        return None
    distance, angle = f"{off_m:.2f} m", f"{np.rad2deg(off_rad):.0f} deg"
    axis = _main_axis(prior.rotation.T @ found.rotation) if angle != _NO_ANGLE else ""
    cause = f"the pose of {placement.lidar} or {target} differs from the prior"
    if axis and off_rad >= _HALF_TURN_RAD:
        cause = f"{placement.lidar} or {target} is mounted {_MOUNTED[axis]}, or the prior is wrong"
    if exchanged is not None:
        cause = f"{exchanged[0]} and {exchanged[1]} have exchanged names, here or in the prior; everything else agrees"
    turned = f"turned by {angle}{f' about its {axis} axis' if axis else ''} against its prior"
    if angle == _NO_ANGLE:
        difference = f"{distance} away from its prior"
    elif distance == _NO_DISTANCE:
        difference = turned
    else:
        difference = f"{turned} and {distance} away from it"
    return f"{placement.lidar} is {difference}: {cause}."


def _main_axis(rotation: FloatArray) -> str:
    """Return the axis that the rotation is mainly about; "" if there is none."""
    vector = rotation_vector(rotation)
    along = largest_index(vector)
    return "xyz"[along] if np.abs(vector[along]) >= _MAINLY * np.linalg.norm(vector) else ""
