# SPDX-License-Identifier: Apache-2.0
"""The extrinsics as TOML, for people to read."""

from __future__ import annotations

import json
import math
from typing import Any

from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.results import CalibrationResult, GroundPlane, LidarPlacement
from multilica.sinks.provenance import Provenance
from multilica.sinks.toml_text import toml_text

__all__ = ["calibration_toml", "placed_extrinsics"]

_HEADER = """\
# Extrinsics of the LiDARs of one rig.
# T_target_source maps a point of the LiDAR's own frame to the frame of {target}: p_target = T_target_source @ p_source.
# Lengths in metres; rpy_deg in degrees, extrinsic xyz (roll, then pitch, then yaw about the fixed axes of {target});
# quaternion_xyzw with w last; fitness is the share of points that found a surface, rmse_m their RMS distance to it;
# sigma_xyz_m, sigma_rotation_deg: one standard deviation along and about the axes of {target}.
"""


def calibration_toml(result: CalibrationResult, provenance: Provenance) -> str:
    """What `calibration.toml` holds; `multilica.read_extrinsics` reads it back."""
    table = extrinsics_table(placed_extrinsics(result))
    lidars = table.pop("lidars")
    document = {
        **table,
        "status": result.status,
        "target_reason": result.target_reason,
        "lidars": {name: {**pose, **_quality(result[name])} for name, pose in lidars.items()},
        "not_placed": {place.lidar: place.reason for place in result.placements if not place.placed},
        "input": {"source": provenance.input.get("source", ""), "sha256": provenance.input.get("sha256", "")},
        "versions": dict(provenance.versions),
    }
    if result.ground is not None:
        document["ground"] = _ground_table(result.ground)
    return _HEADER.format(target=json.dumps(result.target)) + "\n" + toml_text(document)


def placed_extrinsics(result: CalibrationResult) -> Extrinsics:
    """The poses of those LiDARs that were placed, the target's identity among them."""
    poses = {
        place.lidar: place.T_target_source
        for place in result.placements
        if place.placed and place.T_target_source is not None
    }
    return Extrinsics(result.target, poses)


def _quality(placement: LidarPlacement) -> dict[str, Any]:
    figures = {"fitness": placement.fitness, "rmse_m": placement.rmse_m}
    sigmas = {"sigma_xyz_m": placement.sigma_xyz_m, "sigma_rotation_deg": placement.sigma_rotation_deg}
    return {
        **{name: figure for name, figure in figures.items() if math.isfinite(figure)},
        **{name: sigma.tolist() for name, sigma in sigmas.items() if sigma is not None},
    }


def _ground_table(ground: GroundPlane) -> dict[str, Any]:
    base_pose = ground.T_base_target
    return {
        "base": base_pose.target,
        "T_base_target": base_pose.matrix.tolist(),
        "xyz_m": base_pose.xyz_m.tolist(),
        "rpy_deg": base_pose.rpy_deg.tolist(),
    }
