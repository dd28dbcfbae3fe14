# SPDX-License-Identifier: Apache-2.0
"""Extrinsics as URDF and as matrices."""

import shlex
from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform

MATRIX_FRAMES = "# T_target_source "
"""Start of the line above a matrix, before its target and source."""


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


def matrix_text(extrinsics: Extrinsics) -> str:
    """Return four lines per frame, below a comment with target and source."""
    return "# p_target = T_target_source @ p_source, in metres.\n" + "".join(
        f"{MATRIX_FRAMES}{shlex.join((pose.target, pose.source))}\n"
        + "".join(f"{number_list(row)}\n" for row in pose.matrix.tolist())
        for pose in child_poses(extrinsics)
    )
