# SPDX-License-Identifier: Apache-2.0
"""Extrinsics as JSON in the format of OpenCalib (SensorsCalibration): ``p_B = T @ p_A`` in `A-to-B-extrinsic`."""

import json
import re
from pathlib import Path

from multilica.documents import MAX_JSON_BYTES, parse_json, read_limited
from multilica.exports.frame_tree import extrinsics_of_poses
from multilica.exports.values import mapping_of, pose_of_matrix
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import child_poses

_NAME = re.compile(r"(.+)-to-(.+)-extrinsic")
_DOUBLE = 6
"""OpenCV's number of the type of 64-bit floats."""


def opencalib_json(extrinsics: Extrinsics) -> str:
    """Return an entry per frame; the tools of OpenCalib read the first one of a file only."""
    document = {
        f"{pose.source}-to-{pose.target}-extrinsic": {
            "sensor_name": pose.source,
            "target_sensor_name": pose.target,
            "device_type": "relational",
            "param_type": "extrinsic",
            "param": {
                "time_lag": 0,
                "sensor_calib": {
                    "rows": 4,
                    "cols": 4,
                    "type": _DOUBLE,
                    "continuous": True,
                    "data": pose.matrix.tolist(),
                },
            },
        }
        for pose in child_poses(extrinsics)
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def read_opencalib(path: Path) -> Extrinsics:
    """Read the extrinsics of one or more pairs of sensors.

    Raises:
        ValueError: it is not such a file, or the transforms are no tree.
    """
    document = mapping_of(parse_json(read_limited(path, MAX_JSON_BYTES)), "the document")
    return extrinsics_of_poses(_pose(name, entry) for name, entry in document.items())


def _pose(name: str, entry: object) -> RigidTransform:
    values = mapping_of(entry, f"'{name}'")
    named = _NAME.fullmatch(name)
    source, target = values.get("sensor_name"), values.get("target_sensor_name")
    if named and not (source and target):
        source, target = named[1], named[2]
    if not isinstance(source, str) or not isinstance(target, str):
        raise ValueError(  # noqa: TRY004 - of a document
            f"'{name}' names no two sensors; expected the name SOURCE-to-TARGET-extrinsic"
        )
    calibration = mapping_of(mapping_of(values.get("param"), "'param'").get("sensor_calib"), "'sensor_calib'")
    rows = calibration.get("data")
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"'{name}' has no 'data' with rows of numbers")
    return pose_of_matrix(target, source, rows)
