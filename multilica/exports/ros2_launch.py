# SPDX-License-Identifier: Apache-2.0
"""ROS 2 launch files in Python and YAML, and command lines."""

import ast
import json
import warnings
from collections.abc import Iterator
from pathlib import Path

from multilica.documents import MAX_YAML_BYTES, parse_yaml, read_limited
from multilica.exports.frame_tree import extrinsics_of_poses
from multilica.exports.static_publisher import (
    EXECUTABLE,
    PACKAGE,
    node_name,
    pose_of_arguments,
    ros2_arguments,
    split_arguments,
)
from multilica.exports.values import read_text
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import child_poses

_PYTHON = """\
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
{nodes}        ]
    )
"""
_NODE = """\
            Node(
                package="{package}",
                executable="{executable}",
                name="{name}",
                arguments={arguments},
            ),
"""


def launch_python(extrinsics: Extrinsics) -> str:
    """Return a launch file in Python."""
    nodes = (
        _NODE.format(
            package=PACKAGE, executable=EXECUTABLE, name=node_name(pose), arguments=json.dumps(ros2_arguments(pose))
        )
        for pose in child_poses(extrinsics)
    )
    return _PYTHON.format(nodes="".join(nodes))


def launch_yaml(extrinsics: Extrinsics) -> str:
    """Return a launch file in YAML."""
    nodes = (
        f"  - node:\n      pkg: {PACKAGE}\n      exec: {EXECUTABLE}\n      name: {node_name(pose)}\n"
        f'      args: "{" ".join(ros2_arguments(pose))}"\n'
        for pose in child_poses(extrinsics)
    )
    return f"launch:\n{''.join(nodes)}"


def command_lines(extrinsics: Extrinsics) -> str:
    """Return a command per frame; each of them runs until it is stopped."""
    return "".join(
        f"ros2 run {PACKAGE} {EXECUTABLE} {' '.join(ros2_arguments(pose))}\n" for pose in child_poses(extrinsics)
    )


def read_launch_python(path: Path) -> Extrinsics:
    """Read the static transforms of a launch file in Python, without running it.

    Raises:
        ValueError: it is not Python, a transform is not a constant, or they are no tree.
    """
    text = read_text(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
        return extrinsics_of_poses(_constant_pose(call) for call in ast.walk(tree) if _publishes(call))
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError("it is not Python") from error


def _publishes(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and any(
        keyword.arg in ("executable", "node_executable")
        and isinstance(keyword.value, ast.Constant)
        and keyword.value.value == EXECUTABLE
        for keyword in node.keywords
    )


def _constant_pose(call: ast.AST) -> RigidTransform:
    line = getattr(call, "lineno", 0)
    given = {keyword.arg: keyword.value for keyword in getattr(call, "keywords", ())}
    if "condition" in given:
        raise ValueError(f"the node in line {line} has a condition; expected none")
    try:
        package = ast.literal_eval(given.get("package", given.get("node_package", ast.Constant(PACKAGE))))
        words = [str(word) for word in ast.literal_eval(given["arguments"])]
    except (KeyError, ValueError, TypeError) as error:
        raise ValueError(f"the node in line {line} has arguments that are not constants") from error
    return pose_of_arguments(str(package), words)


def read_launch_yaml(path: Path) -> Extrinsics:
    """Read the static transforms of a launch file in YAML.

    Raises:
        ValueError: it is not YAML, a transform is not a constant, or they are no tree.
    """
    return extrinsics_of_poses(_yaml_poses(parse_yaml(read_limited(path, MAX_YAML_BYTES)), conditional=False))


def _yaml_poses(value: object, *, conditional: bool) -> Iterator[RigidTransform]:
    if isinstance(value, list):
        for item in value:
            yield from _yaml_poses(item, conditional=conditional)
    elif isinstance(value, dict):
        depends = conditional or "if" in value or "unless" in value
        if value.get("exec") == EXECUTABLE:
            if depends:
                raise ValueError(f"node '{value.get('name', '')}' has a condition; expected none")
            yield pose_of_arguments(str(value.get("pkg", "")), split_arguments(str(value.get("args", ""))))
            return
        for item in value.values():
            yield from _yaml_poses(item, conditional=depends)


def read_command_lines(path: Path) -> Extrinsics:
    """Read command lines of ROS 1 or ROS 2; other lines are ignored.

    Raises:
        ValueError: a command is wrong, or the transforms are no tree.
    """
    lines = read_text(path).replace("\\\n", " ").splitlines()
    return extrinsics_of_poses(_pose_of_command(line) for line in lines if EXECUTABLE in line.partition("#")[0])


def _pose_of_command(line: str) -> RigidTransform:
    words = [word for word in split_arguments(line) if word != "&"]
    at = words.index(EXECUTABLE) if EXECUTABLE in words else len(words)
    return pose_of_arguments(words[at - 1] if at else "", words[at + 1 :])
