# SPDX-License-Identifier: Apache-2.0
"""The calibration as a TOML file for people."""

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import tomli_w

from multilica.extrinsics import Extrinsics, extrinsics_table, pose_values
from multilica.results import CalibrationResult, GroundPlane, LidarPlacement
from multilica.sinks.files.provenance import Provenance

__all__ = ["calibration_toml", "toml_text"]

_NUMBERS = re.compile(r"\[\n([-+\d.eE,\s]+?),?\s*\]")
_HEADER = """\
# Extrinsics of the LiDARs of one rig.
# T_target_source maps a point of the LiDAR's own frame to the frame of {target}: p_target = T_target_source @ p_source.
# Lengths in metres; rpy_deg in degrees, extrinsic xyz (roll, then pitch, then yaw about the fixed axes of {target});
# quaternion_xyzw with w last; fitness is the share of points near a surface, rmse_m their RMS distance to it;
# sigma_xyz_m, sigma_rotation_deg: one standard deviation along and about the axes of {target}.
# [lidars] has the placed LiDARs. [uncertain] has those whose sigma is above the limit: use them only after a check.
"""


def calibration_toml(result: CalibrationResult, provenance: Provenance) -> str:
    """Return the text of `calibration.toml`; `multilica.read_extrinsics` reads it."""
    placed = [place for place in result.placements if place.placed]
    poses = {place.lidar: place.T_target_source for place in placed if place.T_target_source is not None}
    table = extrinsics_table(Extrinsics(result.target, poses))
    for place in placed:
        table["lidars"][place.lidar].update(_figures(place))
    table |= {
        "status": result.status,
        "target_reason": result.target_reason,
        "uncertain": {
            place.lidar: {"reason": place.reason, **pose_values(place.T_target_source), **_figures(place)}
            for place in result.placements
            if place.uncertain and place.T_target_source is not None
        },
        "not_placed": {place.lidar: place.reason for place in result.placements if place.status == "not_placed"},
        "input": {"source": provenance.input.source, "sha256": provenance.input.sha256},
        "versions": provenance.versions,
    }
    if result.ground is not None:
        table["ground"] = _ground(result.ground)
    elif result.ground_refusal:
        table["no_ground"] = result.ground_refusal
    return f"{_HEADER.format(target=json.dumps(result.target))}\n{toml_text(table)}"


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML with each row of numbers on one line."""
    return _NUMBERS.sub(lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]", tomli_w.dumps(document))


def _figures(placement: LidarPlacement) -> dict[str, Any]:
    """Return the figures of a placement that are known."""
    names = ("fitness", "rmse_m", "sigma_xyz_m", "sigma_rotation_deg")
    figures = {name: getattr(placement, name) for name in names}
    known = {name: np.asarray(value) for name, value in figures.items() if value is not None}
    return {name: value.tolist() for name, value in known.items() if np.all(np.isfinite(value))}


def _ground(ground: GroundPlane) -> dict[str, Any]:
    pose = ground.T_base_target
    return {
        "base": pose.target,
        "T_base_target": pose.matrix.tolist(),
        "xyz_m": pose.xyz_m.tolist(),
        "rpy_deg": pose.rpy_deg.tolist(),
        "area_m2": ground.area_m2,
        "residual_m": ground.residual_m,
        "sigma_z_m": ground.sigma_z_m,
        "sigma_roll_pitch_deg": ground.sigma_roll_pitch_deg.tolist(),
        "doubt": ground.doubt,
    }
