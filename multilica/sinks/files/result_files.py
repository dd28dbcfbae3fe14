# SPDX-License-Identifier: Apache-2.0
"""Result files: `calibration.toml` for people, `result.json` for programs; extrinsics as URDF and as matrices."""

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import tomli_w

from multilica import events
from multilica.config import CalibrationConfig
from multilica.extrinsics import Extrinsics, extrinsics_table, pose_values
from multilica.geometry import RigidTransform
from multilica.results.document import GroundEntry, LidarEntry, ResultDocument
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.run_state import RunState

_NUMBERS = re.compile(r"\[\n([-+\d.eE,\s]+?),?\s*\]")
_HEADER = """\
# Extrinsics of the LiDARs of one rig.
# T_target_source maps a point of the LiDAR's own frame to the frame of {target}: p_target = T_target_source @ p_source.
# Lengths in metres; rpy_deg in degrees, extrinsic xyz (roll, then pitch, then yaw about the fixed axes of {target});
# quaternion_xyzw with w last; fitness is the share of points near a surface, rmse_m their RMS distance to it;
# sigma_xyz_m, sigma_rotation_deg: one standard deviation along and about the axes of {target}; covariance: rotation
# (rad), then translation (m), along the same axes, with systematic errors.
# [sensor_biases]: estimated systematic errors of the LiDARs, with sigma. No pose and no point is corrected by them.
# [lidars] has the placed LiDARs. [uncertain] has those whose sigma is above the limit: use them only after a check.
"""
MATRIX_FRAMES = "# T_target_source "
"""Start of the line above a matrix, before its target and source."""
RESULT_JSON = "result.json"
CALIBRATION_TOML = "calibration.toml"
REPORT_HTML = "report.html"
MCAP = "result.mcap"


def calibration_toml(document: ResultDocument) -> str:
    """Return the text of `calibration.toml`; `multilica.read_extrinsics` reads it."""
    poses = {name: pose for name, pose in document.poses.items() if document.lidars[name].placed}
    table = extrinsics_table(Extrinsics(document.target, poses, covariances=document.covariances))
    for name in poses:
        table["lidars"][name].update(_figures(document.lidars[name]))
    table |= {
        "status": document.status,
        "target_reason": document.target_reason,
        "uncertain": {
            name: {
                "reason": document.lidars[name].reason,
                **pose_values(pose),
                "covariance": document.lidars[name].covariance,
                **_figures(document.lidars[name]),
            }
            for name, pose in document.poses.items()
            if not document.lidars[name].placed
        },
        "not_placed": {name: each.reason for name, each in document.lidars.items() if each.status == "not_placed"},
        "input": {"source": document.input.source, "sha256": document.input.sha256},
        "versions": document.versions,
    }
    if biases := sensor_biases(document):
        table["sensor_biases"] = biases
    if document.ground is not None:
        table["ground"] = _ground(document.ground)
    elif document.ground_refusal:
        table["no_ground"] = document.ground_refusal
    return f"{_HEADER.format(target=json.dumps(document.target))}\n{toml_text(table)}"


def sensor_biases(document: ResultDocument) -> dict[str, dict[str, float]]:
    """Return the estimated systematic errors by LiDAR, with their standard deviations."""
    biases = () if document.refinement is None else document.refinement.biases
    return {each.lidar: {name: value for name, value in asdict(each).items() if name != "lidar"} for each in biases}


def config_toml(config: CalibrationConfig) -> str:
    """Return the resolved configuration as TOML."""
    return toml_text(config.model_dump(mode="json"))


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML with each row of numbers on one line."""
    return _NUMBERS.sub(lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]", tomli_w.dumps(document))


def _figures(lidar: LidarEntry) -> dict[str, Any]:
    names = ("fitness", "rmse_m", "sigma_xyz_m", "sigma_rotation_deg")
    return {name: value for name in names if (value := getattr(lidar, name)) is not None}


def _ground(ground: GroundEntry) -> dict[str, Any]:
    names = ("T_base_target", "xyz_m", "rpy_deg", "area_m2", "residual_m", "sigma_z_m", "sigma_roll_pitch_deg", "doubt")
    return {"base": ground.frame, **{name: getattr(ground, name) for name in names}}


def child_poses(extrinsics: Extrinsics) -> list[RigidTransform]:
    """Return the poses in the common frame by name, without the common frame itself."""
    named = sorted(extrinsics.T_target_source.items())
    return [RigidTransform(extrinsics.target, name, pose.matrix) for name, pose in named if name != extrinsics.target]


def number_text(value: float) -> str:
    """Return the shortest text that reads back as the same number; with a dot, which YAML 1.1 needs."""
    mantissa, exponent, power = repr(float(value) + 0.0).partition("e")
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}{exponent}{power}"


def number_list(values: Sequence[float]) -> str:
    """Return numbers with a space between them."""
    return " ".join(map(number_text, values))


def urdf_text(extrinsics: Extrinsics) -> str:
    """Return a URDF file with a fixed joint per frame."""
    poses, robot = child_poses(extrinsics), ET.Element("robot", name="lidars")
    for name in (extrinsics.target, *(pose.source for pose in poses)):
        ET.SubElement(robot, "link", name=name)
    for pose in poses:
        joint = ET.SubElement(robot, "joint", name=f"{pose.source}_joint", type="fixed")
        ET.SubElement(joint, "parent", link=pose.target)
        ET.SubElement(joint, "child", link=pose.source)
        xyz, rpy = (number_list(values.tolist()) for values in (pose.xyz_m, pose.rpy_rad))
        ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    ET.indent(robot)
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, "unicode")}\n'


def matrix_text(extrinsics: Extrinsics) -> str:
    """Return four lines per frame, below a comment with target and source."""
    return "# p_target = T_target_source @ p_source, in metres.\n" + "".join(
        f"{MATRIX_FRAMES}{shlex.join((pose.target, pose.source))}\n"
        + "".join(f"{number_list(row)}\n" for row in pose.matrix.tolist())
        for pose in child_poses(extrinsics)
    )


@dataclass(frozen=True, slots=True, eq=False)
class ResultFiles:
    """A sink that writes `result.json` and `calibration.toml` into a directory once the calibration has finished."""

    directory: Path
    state: RunState = field(default_factory=RunState)

    def __call__(self, event: events.Event) -> None:
        """Take in an event; write at the last one."""
        self.state(event)
        if isinstance(event, events.CalibrationFinished):
            document = self.state.document
            write_text_atomically(self.directory / RESULT_JSON, f"{document.model_dump_json(indent=2)}\n")
            write_text_atomically(self.directory / CALIBRATION_TOML, calibration_toml(document))
