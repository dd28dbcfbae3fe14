# SPDX-License-Identifier: Apache-2.0
"""URDF files."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from multilica.exports.frame_tree import extrinsics_of_joints
from multilica.exports.values import child_poses, number_list
from multilica.extrinsics import Extrinsics
from multilica.ingest.transforms.urdf import read_urdf

__all__ = ["read_urdf_extrinsics", "urdf_text"]


def urdf_text(extrinsics: Extrinsics) -> str:
    """Return a URDF file with a fixed joint per frame."""
    poses = child_poses(extrinsics)
    links = (f"  <link name={quoteattr(name)}/>\n" for name in (extrinsics.target, *(pose.source for pose in poses)))
    joints = (
        f'  <joint name={quoteattr(f"{pose.source}_joint")} type="fixed">\n'
        f"    <parent link={quoteattr(pose.target)}/>\n"
        f"    <child link={quoteattr(pose.source)}/>\n"
        f'    <origin xyz="{number_list(pose.xyz_m.tolist())}" rpy="{number_list(pose.rpy_rad.tolist())}"/>\n'
        "  </joint>\n"
        for pose in poses
    )
    return f'<?xml version="1.0"?>\n<robot name="lidars">\n{"".join(links)}{"".join(joints)}</robot>\n'


def read_urdf_extrinsics(path: Path) -> Extrinsics:
    """Read the pose of every link in the root link.

    Raises:
        ValueError: the joints are no tree.
    """
    return extrinsics_of_joints(read_urdf(path))
