# SPDX-License-Identifier: Apache-2.0
"""Matrices as text: KITTI's lines `Tr_SOURCE_to_TARGET`, and plain 4 x 4 matrices below their frames."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from multilica.errors import UsageError
from multilica.exports.frame_tree import extrinsics_of_poses
from multilica.exports.values import pose_of_matrix, read_text
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import MATRIX_FRAMES, child_poses, number_list

KITTI_LINE = re.compile(r"^Tr_(?P<source>\S{1,255}?)_to_(?P<target>\S{1,255}?): *(?P<numbers>.*)$", re.MULTILINE)


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
    """Read the rigid transforms of a calibration file of KITTI, such as ``Tr_velo_to_cam``.

    Raises:
        ValueError: a line is wrong, or the transforms are no tree.
    """
    return extrinsics_of_poses(_kitti_poses(read_text(path)))


def _kitti_poses(text: str) -> Iterator[RigidTransform]:
    for line in KITTI_LINE.finditer(text):
        words = line["numbers"].split()
        if len(words) != 12:
            raise ValueError(f"'Tr_{line['source']}_to_{line['target']}' has {len(words)} numbers; expected 12")
        yield pose_of_matrix(line["target"], line["source"], [words[row : row + 4] for row in (0, 4, 8)])


def read_matrices(path: Path) -> Extrinsics:
    """Read 4 x 4 matrices, each below a comment ``# T_target_source TARGET SOURCE``.

    Raises:
        ValueError: a matrix has no such comment or is not rigid, or the transforms are no tree.
    """
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
