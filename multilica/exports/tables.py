# SPDX-License-Identifier: Apache-2.0
"""Extrinsics as a TOML table without the figures of a run, and as a CSV table."""

import csv
from collections.abc import Mapping
from io import StringIO
from pathlib import Path

from multilica.exports.values import extrinsics_of_poses, numbers, pose_of_quaternion, read_text
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica.sinks.files.result_files import toml_text
from multilica.sinks.text.extrinsics_text import child_poses, number_text

_XYZ, _QUATERNION, _ANGLES = ("x_m", "y_m", "z_m"), ("qx", "qy", "qz", "qw"), ("roll_deg", "pitch_deg", "yaw_deg")
_READ = ("target", "source", *_XYZ, *_QUATERNION)


def toml_extrinsics(extrinsics: Extrinsics) -> str:
    """Return the table with a pose per frame."""
    poses = {pose.source: pose for pose in child_poses(extrinsics)}
    return toml_text(extrinsics_table(Extrinsics(extrinsics.target, poses)))


def csv_text(extrinsics: Extrinsics) -> str:
    """Return a row per frame; the angles repeat the quaternion."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*_READ, *_ANGLES))
    for pose in child_poses(extrinsics):
        values = (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist(), *pose.rpy_deg.tolist())
        writer.writerow((pose.target, pose.source, *map(number_text, values)))
    return text.getvalue()


def read_csv(path: Path) -> Extrinsics:
    """Read a table with these columns, in any order; others are ignored."""
    rows = csv.DictReader(StringIO(read_text(path)))
    try:
        missing = [name for name in _READ if name not in (rows.fieldnames or ())]
        if missing:
            raise ValueError(f"it has no column '{missing[0]}'; expected {', '.join(_READ)}")
        return extrinsics_of_poses([_pose(row) for row in rows])
    except csv.Error as error:
        raise ValueError(f"it is not a CSV table: {error}") from error


def _pose(row: Mapping[str, str]) -> RigidTransform:
    target, source = row["target"], row["source"]
    xyz_m = numbers([row[name] for name in _XYZ], f"the translation of '{source}'")
    xyzw = numbers([row[name] for name in _QUATERNION], f"the quaternion of '{source}'")
    return pose_of_quaternion(target, source, xyz_m, xyzw)
