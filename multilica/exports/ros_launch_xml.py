# SPDX-License-Identifier: Apache-2.0
"""Launch files in XML, of ROS 1 and ROS 2."""

from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.sax.saxutils import quoteattr

from multilica.exports.frame_tree import extrinsics_of_poses
from multilica.exports.static_publisher import (
    EXECUTABLE,
    PACKAGE,
    node_name,
    pose_of_arguments,
    ros1_arguments,
    ros2_arguments,
    split_arguments,
)
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms.urdf import parse_xml
from multilica.sinks.text.extrinsics_text import child_poses


def ros1_launch_xml(extrinsics: Extrinsics) -> str:
    """Return a launch file of ROS 1."""
    return _launch(extrinsics, "type", ros1_arguments)


def ros2_launch_xml(extrinsics: Extrinsics) -> str:
    """Return a launch file of ROS 2."""
    return _launch(extrinsics, "exec", ros2_arguments)


def _launch(extrinsics: Extrinsics, key: str, arguments: Callable[[RigidTransform], tuple[str, ...]]) -> str:
    nodes = (
        f'  <node pkg="{PACKAGE}" {key}="{EXECUTABLE}" name={quoteattr(node_name(pose))}\n'
        f"        args={quoteattr(' '.join(arguments(pose)))}/>\n"
        for pose in child_poses(extrinsics)
    )
    return f"<launch>\n{''.join(nodes)}</launch>\n"


def read_launch_xml(path: Path) -> Extrinsics:
    """Read the static transforms of a launch file of ROS 1 or ROS 2; files that it includes are not read.

    Raises:
        ValueError: a transform is not a constant, or they are no tree.
    """
    root = parse_xml(path, "launch")
    if root.tag != "launch":
        raise ValueError(f"it begins with <{root.tag}>; expected <launch>")
    return extrinsics_of_poses(_poses(root, conditional=False))


def _poses(element: Element, *, conditional: bool) -> Iterator[RigidTransform]:
    for child in element:
        depends = conditional or child.get("if") is not None or child.get("unless") is not None
        if child.tag == "node" and EXECUTABLE in (child.get("exec"), child.get("type")):
            if depends:
                raise ValueError(f"node '{child.get('name', '')}' has a condition; expected none")
            yield pose_of_arguments(child.get("pkg", ""), split_arguments(child.get("args", "")))
        else:
            yield from _poses(child, conditional=depends)
