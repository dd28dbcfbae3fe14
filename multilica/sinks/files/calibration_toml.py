# SPDX-License-Identifier: Apache-2.0
"""The calibration as a TOML file for people."""

import json
import math
from collections.abc import Mapping

from pydantic import BaseModel

from multilica.extrinsics import EXTRINSICS_SCHEMA, Extrinsics, ExtrinsicsTable, PoseTable, pose_values
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, GroundPlane, LidarPlacement
from multilica.sinks.files.provenance import Provenance
from multilica.sinks.files.toml_text import toml_text

__all__ = ["CalibrationTable", "calibration_toml", "placed_extrinsics"]

_HEADER = """\
# Extrinsics of the LiDARs of one rig.
# T_target_source maps a point of the LiDAR's own frame to the frame of {target}: p_target = T_target_source @ p_source.
# Lengths in metres; rpy_deg in degrees, extrinsic xyz (roll, then pitch, then yaw about the fixed axes of {target});
# quaternion_xyzw with w last; fitness is the share of points near a surface, rmse_m their RMS distance to it;
# sigma_xyz_m, sigma_rotation_deg: one standard deviation along and about the axes of {target}.
"""


class PlacedTable(PoseTable):
    """A placed LiDAR with its quality; figures that are not known are left out."""

    fitness: float | None
    rmse_m: float | None
    sigma_xyz_m: tuple[float, ...] | None
    sigma_rotation_deg: tuple[float, ...] | None


class InputTable(BaseModel):
    """The file that was calibrated."""

    source: str
    sha256: str


class GroundTable(BaseModel):
    """The target LiDAR in a base frame on the ground below it."""

    base: str
    T_base_target: tuple[tuple[float, ...], ...]
    xyz_m: tuple[float, ...]
    rpy_deg: tuple[float, ...]


class CalibrationTable(ExtrinsicsTable):
    """Content of `calibration.toml`; `multilica.read_extrinsics` reads it."""

    status: str
    target_reason: str
    lidars: Mapping[str, PlacedTable]
    not_placed: Mapping[str, str]
    input: InputTable
    versions: Mapping[str, str]
    ground: GroundTable | None


def calibration_toml(result: CalibrationResult, provenance: Provenance) -> str:
    """Return the text of `calibration.toml`."""
    poses = placed_extrinsics(result).T_target_source
    table = CalibrationTable(
        schema=EXTRINSICS_SCHEMA,
        target=result.target,
        status=result.status,
        target_reason=result.target_reason,
        lidars={name: _placed(result[name], poses[name]) for name in sorted(poses)},
        not_placed={place.lidar: place.reason for place in result.placements if not place.placed},
        input=InputTable(source=provenance.input.source, sha256=provenance.input.sha256),
        versions=provenance.versions,
        ground=None if result.ground is None else _ground(result.ground),
    )
    text = toml_text(table.model_dump(mode="json", exclude_none=True))
    return f"{_HEADER.format(target=json.dumps(result.target))}\n{text}"


def placed_extrinsics(result: CalibrationResult) -> Extrinsics:
    """Return the poses of the placed LiDARs, the target's identity among them."""
    poses = {
        place.lidar: place.T_target_source
        for place in result.placements
        if place.placed and place.T_target_source is not None
    }
    return Extrinsics(result.target, poses)


def _placed(placement: LidarPlacement, pose: RigidTransform) -> PlacedTable:
    xyz_m, rotation_deg = placement.sigma_xyz_m, placement.sigma_rotation_deg
    return PlacedTable(
        **pose_values(pose),
        fitness=placement.fitness if math.isfinite(placement.fitness) else None,
        rmse_m=placement.rmse_m if math.isfinite(placement.rmse_m) else None,
        sigma_xyz_m=None if xyz_m is None else xyz_m.tolist(),
        sigma_rotation_deg=None if rotation_deg is None else rotation_deg.tolist(),
    )


def _ground(ground: GroundPlane) -> GroundTable:
    pose = ground.T_base_target
    return GroundTable(
        base=pose.target,
        T_base_target=pose.matrix.tolist(),
        xyz_m=pose.xyz_m.tolist(),
        rpy_deg=pose.rpy_deg.tolist(),
    )
