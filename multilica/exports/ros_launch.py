# SPDX-License-Identifier: Apache-2.0
"""Static transforms of ROS in launch files, command lines and recordings.

Arguments of ROS 1: ``x y z qx qy qz qw parent child`` or ``x y z yaw pitch roll parent child``; the node of the package
`tf` also takes a period in milliseconds. ROS 2: named arguments; those of ROS 1 are deprecated.
"""

import ast
import json
import re
import shlex
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element

from multilica.documents import MAX_YAML_BYTES, parse_yaml, read_limited
from multilica.errors import UsageError
from multilica.exports.values import numbers, pose_of_quaternion, pose_of_rpy, read_text
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms import parse_xml
from multilica.sinks.files.result_files import child_poses, number_text

EXECUTABLE = "static_transform_publisher"
_MAX_COMMAND = 4096
"""The splitter needs a second per 100,000 characters."""
_TRANSLATION, _ANGLES, _QUATERNION = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("qx", "qy", "qz", "qw")
_PARENT, _CHILD = "frame-id", "child-frame-id"
_NAMES = (*_TRANSLATION, *_ANGLES, *_QUATERNION, _PARENT, _CHILD)
_FRAME = re.compile(r"[^\s\"'`$\\/&|;<>()#*?~{}\[\]!-][^\s\"'`$\\&|;<>()#*?~{}\[\]!]*")
_PYTHON = """\
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
{nodes}        ]
    )
"""
_PYTHON_NODE = """\
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                name="{name}",
                arguments={listed},
            ),
"""
_YAML_NODE = """\
  - node:
      pkg: tf2_ros
      exec: static_transform_publisher
      name: {name}
      args: "{words}"
"""
_XML_NODE = """\
  <node pkg="tf2_ros" %s="static_transform_publisher" name="{name}"
        args="{words}"/>
"""
_XML = "<launch>\n{nodes}</launch>\n"


def tf_static_mcap(extrinsics: Extrinsics) -> bytes:
    """Return a ROS 2 recording with `/tf_static`."""
    from multilica.sinks.snapshots import static_transforms_mcap

    return static_transforms_mcap(child_poses(extrinsics))


def _ros1_arguments(pose: RigidTransform) -> list[str]:
    values = (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist())
    return [*map(number_text, values), _frame(pose.target), _frame(pose.source)]


def _ros2_arguments(pose: RigidTransform) -> list[str]:
    names = (*_TRANSLATION, *_QUATERNION, _PARENT, _CHILD)
    return [word for name, value in zip(names, _ros1_arguments(pose), strict=True) for word in (f"--{name}", value)]


def _text(
    node: str, whole: str, extrinsics: Extrinsics, arguments: Callable[[RigidTransform], list[str]] = _ros2_arguments
) -> str:
    """Fill in the text of a node per frame, then that of the file; no argument needs quotes (`_frame`)."""
    poses = child_poses(extrinsics)
    names = _node_names([pose.source for pose in poses])
    words = [arguments(pose) for pose in poses]
    nodes = (
        node.format(name=name, words=" ".join(own), listed=json.dumps(own))
        for name, own in zip(names, words, strict=True)
    )
    return whole.format(nodes="".join(nodes))


def _node_names(frames: Sequence[str]) -> list[str]:
    """Return a name of its own for the node of each frame, as ROS allows it."""
    names: list[str] = []
    for frame in frames:
        name = first = "static_transform_" + re.sub(r"\W", "_", frame, flags=re.ASCII)
        number = 2
        while name in names:
            name, number = f"{first}_{number}", number + 1
        names.append(name)
    return names


launch_python = partial(_text, _PYTHON_NODE, _PYTHON)
launch_yaml = partial(_text, _YAML_NODE, "launch:\n{nodes}")
ros1_launch_xml = partial(_text, _XML_NODE % "type", _XML, arguments=_ros1_arguments)
ros2_launch_xml = partial(_text, _XML_NODE % "exec", _XML)
command_lines = partial(_text, "ros2 run tf2_ros static_transform_publisher {words}\n", "{nodes}")
"""A command per frame; each of them runs until it is stopped."""


def read_launch_python(path: Path) -> list[RigidTransform]:
    """Read the static transforms of a launch file in Python, without running it."""
    text = read_text(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
        return [_constant_pose(call) for call in ast.walk(tree) if _publishes(call)]
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
        package = ast.literal_eval(given.get("package", given.get("node_package", ast.Constant("tf2_ros"))))
        words = [str(word) for word in ast.literal_eval(given["arguments"])]
    except (KeyError, ValueError, TypeError) as error:
        raise ValueError(f"the node in line {line} has arguments that are not constants") from error
    return _pose_of_arguments(str(package), words)


def read_launch_yaml(path: Path) -> Iterator[RigidTransform]:
    """Read the static transforms of a launch file in YAML."""
    return _yaml_poses(parse_yaml(read_limited(path, MAX_YAML_BYTES)), conditional=False)


def _yaml_poses(value: object, *, conditional: bool) -> Iterator[RigidTransform]:
    if isinstance(value, list):
        for item in value:
            yield from _yaml_poses(item, conditional=conditional)
    elif isinstance(value, dict):
        depends = conditional or "if" in value or "unless" in value
        if value.get("exec") == EXECUTABLE:
            if depends:
                raise ValueError(f"node '{value.get('name', '')}' has a condition; expected none")
            yield _pose_of_arguments(str(value.get("pkg", "")), split_arguments(str(value.get("args", ""))))
            return
        for item in value.values():
            yield from _yaml_poses(item, conditional=depends)


def read_command_lines(path: Path) -> Iterator[RigidTransform]:
    """Read command lines of ROS 1 or ROS 2; other lines are ignored."""
    for line in read_text(path).replace("\\\n", " ").splitlines():
        if EXECUTABLE in line.partition("#")[0]:
            words = [word for word in split_arguments(line) if word != "&"]
            at = words.index(EXECUTABLE) if EXECUTABLE in words else len(words)
            yield _pose_of_arguments(words[at - 1] if at else "", words[at + 1 :])


def read_launch_xml(path: Path) -> Iterator[RigidTransform]:
    """Read the static transforms of a launch file of ROS 1 or ROS 2; files that it includes are not read."""
    root = parse_xml(path, "launch")
    if root.tag != "launch":
        raise ValueError(f"it begins with <{root.tag}>; expected <launch>")
    yield from _xml_poses(root, conditional=False)


def read_tf_static(path: Path) -> Sequence[RigidTransform]:
    """Read `/tf_static` of an MCAP file or ROS bag."""
    from multilica.ingest.locate import find_source
    from multilica.ingest.opening import open_source
    from multilica.ingest.transforms import read_static_transforms

    with closing(open_source(find_source(path))) as recording:
        poses, notes = read_static_transforms(recording)
    if notes:
        raise ValueError(notes[0].rstrip("."))
    return poses


def _xml_poses(element: Element, *, conditional: bool) -> Iterator[RigidTransform]:
    for child in element:
        depends = conditional or child.get("if") is not None or child.get("unless") is not None
        if child.tag == "node" and EXECUTABLE in (child.get("exec"), child.get("type")):
            if depends:
                raise ValueError(f"node '{child.get('name', '')}' has a condition; expected none")
            yield _pose_of_arguments(child.get("pkg", ""), split_arguments(child.get("args", "")))
        else:
            yield from _xml_poses(child, conditional=depends)


def split_arguments(text: str) -> list[str]:
    """Return the words of a command; raise ValueError, with a clause, if it is none."""
    if len(text) > _MAX_COMMAND:
        raise ValueError(f"it has a command of more than {_MAX_COMMAND} characters")
    return shlex.split(text, comments=True)


def _pose_of_arguments(package: str, arguments: Sequence[str]) -> RigidTransform:
    """Return ``T_parent_child`` of the arguments of a node; raise ValueError, with a clause, if they are wrong."""
    words = list(arguments)
    if "--ros-args" in words:
        words = words[: words.index("--ros-args")]
    if any("$(" in word for word in words):
        raise ValueError(f"'{' '.join(words)}' has a substitution; expected numbers and frames")
    if any(word.startswith("--") for word in words):
        return _named(words)
    if package == "tf":
        words = words[:-1]
    if len(words) not in (8, 9):
        raise ValueError(f"'{' '.join(arguments)}' has {len(arguments)} arguments; expected 6 or 7 numbers, two frames")
    *values, parent, child = words
    turn = values[3:]
    return _pose(parent, child, values[:3], turn if len(turn) == 4 else turn[::-1])


def _named(words: Sequence[str]) -> RigidTransform:
    names = [word.removeprefix("--") for word in words[::2]]
    if len(words) % 2 or any(name not in _NAMES for name in names) or len(set(names)) < len(names):
        raise ValueError(f"'{' '.join(words)}' has other arguments than pairs of a name of {EXECUTABLE} and a value")
    given = dict(zip(names, words[1::2], strict=True))
    if _PARENT not in given or _CHILD not in given:
        raise ValueError(f"'{' '.join(words)}' lacks --{_PARENT} or --{_CHILD}")
    parent, child = given[_PARENT], given[_CHILD]
    xyz_m = [given.get(name, "0") for name in _TRANSLATION]
    if not any(name in given for name in _ANGLES):
        return _pose(parent, child, xyz_m, [given.get(name, "1" if name == "qw" else "0") for name in _QUATERNION])
    if any(name in given for name in _QUATERNION):
        raise ValueError(f"'{child}' has both angles and a quaternion")
    return _pose(parent, child, xyz_m, [given.get(name, "0") for name in _ANGLES])


def _pose(parent: str, child: str, xyz: Sequence[str], turn: Sequence[str]) -> RigidTransform:
    """Return the pose that a quaternion, or roll, pitch and yaw, give."""
    angles = numbers(turn, f"the rotation of '{child}'")
    parent, child = parent.removeprefix("/"), child.removeprefix("/")
    if not parent or not child:
        raise ValueError("a frame has no name")
    xyz_m = numbers(xyz, f"the translation of '{child}'")
    return (pose_of_quaternion if len(angles) == 4 else pose_of_rpy)(parent, child, xyz_m, angles)


def _frame(name: str) -> str:
    """Return a name that needs no quotes in shells and launch files, and does not begin with a slash or dash."""
    if not _FRAME.fullmatch(name):
        raise UsageError(f"A ROS launch file cannot have the frame '{name}'; rename the LiDAR or give --frames ids.")
    return name
