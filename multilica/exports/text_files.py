# SPDX-License-Identifier: Apache-2.0
"""Text files with an entry per frame: TOML, CSV, matrices, KITTI, YAML of Kalibr and Autoware, JSON of OpenCalib."""

import csv
import json
import re
import shlex
from collections.abc import Iterator, Mapping
from io import BytesIO, StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

from multilica.documents import MAX_JSON_BYTES, parse_json, read_limited
from multilica.errors import UnreadableSourceError, UsageError
from multilica.exports.values import (
    extrinsics_of_tree,
    mapping_of,
    numbers,
    pose_of_matrix,
    pose_of_quaternion,
    pose_of_rpy,
    quoted,
    read_text,
    read_yaml,
)
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica.sinks.files.result_files import MATRIX_FRAMES, child_poses, number_list, number_text, toml_text

KALIBR_MATRIX = "T_base_lidar"
KITTI_LINE = re.compile(r"^Tr_(?P<source>\S{1,255}?)_to_(?P<target>\S{1,255}?): *(?P<numbers>.*)$", re.MULTILINE)
_OPENCALIB_NAME = re.compile(r"(.+)-to-(.+)-extrinsic")
_XYZ, _QUATERNION, _ANGLES = ("x_m", "y_m", "z_m"), ("qx", "qy", "qz", "qw"), ("roll_deg", "pitch_deg", "yaw_deg")
_AUTOWARE = ("x", "y", "z", "roll", "pitch", "yaw")
"""Metres and radians, of a child in its parent."""
_NO_BIASES: Mapping[str, Mapping[str, float]] = MappingProxyType({})
_READ = ("target", "source", *_XYZ, *_QUATERNION)


def kitti_text(extrinsics: Extrinsics) -> str:
    """Return a line per frame: the name, then the first three rows of ``T_target_source``."""
    for name in (extrinsics.target, *extrinsics.T_target_source):
        if "_to_" in name or re.search(r"[\s:]", name):
            raise UsageError(f"A file in KITTI's format cannot have the frame '{name}'; rename the LiDAR.")
    return "".join(
        f"Tr_{pose.source}_to_{pose.target}: {number_list(pose.matrix[:3].ravel().tolist())}\n"
        for pose in child_poses(extrinsics)
    )


def read_kitti(path: Path) -> Iterator[RigidTransform]:
    """Read the rigid transforms of a calibration file of KITTI, such as ``Tr_velo_to_cam``."""
    for line in KITTI_LINE.finditer(read_text(path)):
        words = line["numbers"].split()
        if len(words) != 12:
            raise ValueError(f"'Tr_{line['source']}_to_{line['target']}' has {len(words)} numbers; expected 12")
        yield pose_of_matrix(line["target"], line["source"], [words[row : row + 4] for row in (0, 4, 8)])


def read_matrices(path: Path) -> Iterator[RigidTransform]:
    """Read 4 x 4 matrices, each below a comment ``# T_target_source TARGET SOURCE``."""
    before, *parts = re.split(rf"^{MATRIX_FRAMES}", read_text(path), flags=re.MULTILINE)
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


def read_kalibr(path: Path) -> Iterator[RigidTransform]:
    """Read the pose of each entry."""
    for name, value in read_yaml(path).items():
        entry = mapping_of(value, f"'{name}'")
        rows = _rows_of_numbers(entry.get(KALIBR_MATRIX), f"'{name}' has no {KALIBR_MATRIX}")
        yield pose_of_matrix(str(entry.get("base_frame", "base")), str(entry.get("frame", name)), rows)


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
                    "type": 6,  # OpenCV's number of 64-bit floats
                    "continuous": True,
                    "data": pose.matrix.tolist(),
                },
            },
        }
        for pose in child_poses(extrinsics)
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def read_opencalib(path: Path) -> Iterator[RigidTransform]:
    """Read the extrinsics of one or more pairs of sensors."""
    for name, entry in mapping_of(parse_json(read_limited(path, MAX_JSON_BYTES)), "the document").items():
        values = mapping_of(entry, f"'{name}'")
        source, target = values.get("sensor_name"), values.get("target_sensor_name")
        if (named := _OPENCALIB_NAME.fullmatch(name)) and not (source and target):
            source, target = named.groups()
        if not isinstance(source, str) or not isinstance(target, str):
            raise ValueError(  # noqa: TRY004 - of a document
                f"'{name}' names no two sensors; expected the name SOURCE-to-TARGET-extrinsic"
            )
        calibration = mapping_of(mapping_of(values.get("param"), "'param'").get("sensor_calib"), "'sensor_calib'")
        rows = _rows_of_numbers(calibration.get("data"), f"'{name}' has no 'data'")
        yield pose_of_matrix(target, source, rows)


def _rows_of_numbers(rows: object, lack: str) -> list[list[object]]:
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"{lack} with rows of numbers")
    return rows


def toml_extrinsics(extrinsics: Extrinsics, sensor_biases: Mapping[str, Mapping[str, float]] = _NO_BIASES) -> str:
    """Return the table with a pose per frame, and its covariance if it is known.

    Args:
        sensor_biases: estimated systematic errors by frame, which are told, not applied.
    """
    poses = {pose.source: pose for pose in child_poses(extrinsics)}
    table = extrinsics_table(Extrinsics(extrinsics.target, poses, covariances=extrinsics.covariances))
    if not sensor_biases:
        return toml_text(table)
    told = "# [sensor_biases]: estimated systematic errors, with sigma. No pose and no point is corrected by them.\n"
    return told + toml_text(table | {"sensor_biases": sensor_biases})


def csv_text(extrinsics: Extrinsics) -> str:
    """Return a row per frame; the angles repeat the quaternion."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*_READ, *_ANGLES))
    for pose in child_poses(extrinsics):
        values = (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist(), *pose.rpy_deg.tolist())
        writer.writerow((pose.target, pose.source, *map(number_text, values)))
    return text.getvalue()


def read_csv(path: Path) -> Iterator[RigidTransform]:
    """Read a table with these columns, in any order; others are ignored."""
    rows = csv.DictReader(StringIO(read_text(path)))
    try:
        missing = [name for name in _READ if name not in (rows.fieldnames or ())]
        if missing:
            raise ValueError(f"it has no column '{missing[0]}'; expected {', '.join(_READ)}")
        for row in rows:
            xyz_m = numbers([row[name] for name in _XYZ], f"the translation of '{row['source']}'")
            xyzw = numbers([row[name] for name in _QUATERNION], f"the quaternion of '{row['source']}'")
            yield pose_of_quaternion(row["target"], row["source"], xyz_m, xyzw)
    except csv.Error as error:
        raise ValueError(f"it is not a CSV table: {error}") from error


def autoware_yaml(extrinsics: Extrinsics) -> str:
    """Return `sensors_calibration.yaml` or `sensor_kit_calibration.yaml` with the poses below the common frame."""
    return f"{quoted(extrinsics.target)}:\n" + "".join(
        f"  {quoted(pose.source)}:\n"
        + "".join(f"    {key}: {number_text(value)}\n" for key, value in _values(pose).items())
        for pose in child_poses(extrinsics)
    )


def read_autoware(path: Path) -> list[RigidTransform]:
    """Read the pose of each child in its parent."""
    poses = []
    for parent, children in read_yaml(path).items():
        for child, values in mapping_of(children, f"'{parent}'").items():
            given = mapping_of(values, f"'{child}'")
            if set(given) != set(_AUTOWARE):
                raise ValueError(f"'{child}' has {', '.join(given) or 'nothing'}; expected {', '.join(_AUTOWARE)}")
            found = numbers([given[key] for key in _AUTOWARE], f"'{child}'")
            poses.append(pose_of_rpy(parent, child, found[:3], found[3:]))
    return poses


def updated_autoware(path: Path, extrinsics: Extrinsics) -> bytes:
    """Return the file with new or further poses below the common frame; other entries and comments stay.

    Raises:
        UnreadableSourceError: it is not such a file, or the frames would be no tree.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import RoundTripRepresenter

    yaml = YAML(pure=True)
    yaml.Representer = type("Representer", (RoundTripRepresenter,), {})
    yaml.Representer.add_representer(float, _represent_number)
    yaml.preserve_quotes = True
    yaml.width = 4096  # long lines stay as they are
    content = BytesIO()
    try:
        known = read_autoware(path)
        new = child_poses(extrinsics)
        frames = {(pose.target, pose.source) for pose in new}
        extrinsics_of_tree([*(pose for pose in known if (pose.target, pose.source) not in frames), *new])
        document = yaml.load(read_text(path))
        below = document.setdefault(extrinsics.target, {})
        for pose in new:
            below.setdefault(pose.source, {}).update(_values(pose))
        yaml.dump(document, content)
    except ValueError as error:
        raise UnreadableSourceError(f"{path} cannot take the poses: {error}.") from error
    return content.getvalue()


def _represent_number(representer: Any, value: float) -> Any:  # noqa: ANN401 - of ruamel.yaml
    return representer.represent_scalar("tag:yaml.org,2002:float", number_text(value))


def _values(pose: RigidTransform) -> dict[str, float]:
    return dict(zip(_AUTOWARE, (*pose.xyz_m.tolist(), *pose.rpy_rad.tolist()), strict=True))
