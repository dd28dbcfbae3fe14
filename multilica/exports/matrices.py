# SPDX-License-Identifier: Apache-2.0
"""Files with a matrix per frame: plain text, KITTI's, YAML in the manner of Kalibr's, OpenCalib's JSON."""

import json
import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from multilica.documents import MAX_JSON_BYTES, parse_json, read_limited
from multilica.errors import UsageError
from multilica.exports.values import extrinsics_of_poses, mapping_of, pose_of_matrix, quoted, read_text, read_yaml
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import MATRIX_FRAMES, child_poses, number_list, number_text

KALIBR_MATRIX = "T_base_lidar"
KITTI_LINE = re.compile(r"^Tr_(?P<source>\S{1,255}?)_to_(?P<target>\S{1,255}?): *(?P<numbers>.*)$", re.MULTILINE)
_OPENCALIB_NAME = re.compile(r"(.+)-to-(.+)-extrinsic")
_DOUBLE = 6
"""OpenCV's number of the type of 64-bit floats."""


def kitti_text(extrinsics: Extrinsics) -> str:
    """Return a line per frame: the name, then the first three rows of ``T_target_source``."""
    for name in (extrinsics.target, *extrinsics.T_target_source):
        if "_to_" in name or re.search(r"[\s:]", name):
            raise UsageError(f"A file in KITTI's format cannot have the frame '{name}'; rename the LiDAR.")
    return "".join(
        f"Tr_{pose.source}_to_{pose.target}: {number_list(pose.matrix[:3].ravel().tolist())}\n"
        for pose in child_poses(extrinsics)
    )


def read_kitti(path: Path) -> Extrinsics:
    """Read the rigid transforms of a calibration file of KITTI, such as ``Tr_velo_to_cam``."""
    return extrinsics_of_poses(_kitti_poses(read_text(path)))


def _kitti_poses(text: str) -> Iterator[RigidTransform]:
    for line in KITTI_LINE.finditer(text):
        words = line["numbers"].split()
        if len(words) != 12:
            raise ValueError(f"'Tr_{line['source']}_to_{line['target']}' has {len(words)} numbers; expected 12")
        yield pose_of_matrix(line["target"], line["source"], [words[row : row + 4] for row in (0, 4, 8)])


def read_matrices(path: Path) -> Extrinsics:
    """Read 4 x 4 matrices, each below a comment ``# T_target_source TARGET SOURCE``."""
    return extrinsics_of_poses(_matrix_poses(read_text(path)))


def _matrix_poses(text: str) -> Iterator[RigidTransform]:
    before, *parts = re.split(rf"^{MATRIX_FRAMES}", text, flags=re.MULTILINE)
    if _rows(before):
        raise ValueError(f"it has numbers above the first line '{MATRIX_FRAMES}TARGET SOURCE'")
    for part in parts:
        frames, _, rest = part.partition("\n")
        names = shlex.split(frames)
        if len(names) != 2:
            raise ValueError(f"the line '{MATRIX_FRAMES}{frames}' does not have two frames")
        yield pose_of_matrix(names[0], names[1], _rows(rest))


def _rows(text: str) -> list[list[str]]:
    lines = (line.partition("#")[0].split() for line in text.splitlines())
    return [words for words in lines if words]


def kalibr_yaml(extrinsics: Extrinsics) -> str:
    """Return an entry ``lidar0`` and so on per frame."""
    head = f"# p_base = {KALIBR_MATRIX} @ p_lidar, in metres.\n"
    entries = (
        f"lidar{index}:\n  frame: {quoted(pose.source)}\n  base_frame: {quoted(pose.target)}\n  {KALIBR_MATRIX}:\n"
        + "".join(f"  - [{', '.join(map(number_text, row))}]\n" for row in pose.matrix.tolist())
        for index, pose in enumerate(child_poses(extrinsics))
    )
    return head + "".join(entries)


def read_kalibr(path: Path) -> Extrinsics:
    """Read the pose of every frame in the root."""
    document = read_yaml(path)
    return extrinsics_of_poses(_kalibr_pose(name, mapping_of(entry, f"'{name}'")) for name, entry in document.items())


def _kalibr_pose(name: str, entry: Mapping[str, Any]) -> RigidTransform:
    child, parent, rows = str(entry.get("frame", name)), str(entry.get("base_frame", "base")), entry.get(KALIBR_MATRIX)
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"'{name}' has no {KALIBR_MATRIX} with rows of numbers")
    return pose_of_matrix(parent, child, rows)


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
    """Read the extrinsics of one or more pairs of sensors."""
    document = mapping_of(parse_json(read_limited(path, MAX_JSON_BYTES)), "the document")
    return extrinsics_of_poses(_opencalib_pose(name, entry) for name, entry in document.items())


def _opencalib_pose(name: str, entry: object) -> RigidTransform:
    values = mapping_of(entry, f"'{name}'")
    named = _OPENCALIB_NAME.fullmatch(name)
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
