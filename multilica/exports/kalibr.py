# SPDX-License-Identifier: Apache-2.0
"""YAML files in the manner of Kalibr's `camchain.yaml`: numbered sensors with a matrix each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from multilica.exports.frame_tree import extrinsics_of_poses
from multilica.exports.values import mapping_of, pose_of_matrix, quoted, read_yaml
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import child_poses, number_text

MATRIX = "T_base_lidar"


def kalibr_yaml(extrinsics: Extrinsics) -> str:
    """Return an entry ``lidar0`` and so on per frame."""
    head = f"# p_base = {MATRIX} @ p_lidar, in metres.\n"
    entries = (
        f"lidar{index}:\n  frame: {quoted(pose.source)}\n  base_frame: {quoted(pose.target)}\n  {MATRIX}:\n"
        + "".join(f"  - [{', '.join(map(number_text, row))}]\n" for row in pose.matrix.tolist())
        for index, pose in enumerate(child_poses(extrinsics))
    )
    return head + "".join(entries)


def read_kalibr(path: Path) -> Extrinsics:
    """Read the pose of every frame in the root.

    Raises:
        ValueError: it is not such a file, or the transforms are no tree.
    """
    document = read_yaml(path)
    return extrinsics_of_poses(_pose(name, mapping_of(entry, f"'{name}'")) for name, entry in document.items())


def _pose(name: str, entry: Mapping[str, Any]) -> RigidTransform:
    child, parent, rows = str(entry.get("frame", name)), str(entry.get("base_frame", "base")), entry.get(MATRIX)
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"'{name}' has no {MATRIX} with rows of numbers")
    return pose_of_matrix(parent, child, rows)
