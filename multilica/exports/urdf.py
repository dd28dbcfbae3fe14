# SPDX-License-Identifier: Apache-2.0
"""URDF files."""

from pathlib import Path

from multilica.exports.frame_tree import extrinsics_of_joints
from multilica.extrinsics import Extrinsics
from multilica.ingest.transforms.urdf import read_urdf


def read_urdf_extrinsics(path: Path) -> Extrinsics:
    """Read the pose of every link in the root link.

    Raises:
        ValueError: the joints are no tree.
    """
    return extrinsics_of_joints(read_urdf(path))
