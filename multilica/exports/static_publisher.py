# SPDX-License-Identifier: Apache-2.0
"""Arguments of the ROS node `static_transform_publisher`.

ROS 1: ``x y z qx qy qz qw parent child`` or ``x y z yaw pitch roll parent child``; the node of the package `tf` also
takes a period in milliseconds. ROS 2: named arguments; those of ROS 1 are deprecated.
"""

import re
import shlex
from collections.abc import Sequence

from multilica.errors import UsageError
from multilica.exports.values import numbers, pose_of_quaternion, pose_of_rpy
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import number_text

EXECUTABLE = "static_transform_publisher"
PACKAGE = "tf2_ros"
_LEGACY_PACKAGE = "tf"
_MAX_COMMAND = 4096
"""The splitter needs a second per 100,000 characters."""
_TRANSLATION, _ANGLES, _QUATERNION = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("qx", "qy", "qz", "qw")
_PARENT, _CHILD = "frame-id", "child-frame-id"
_NAMES = (*_TRANSLATION, *_ANGLES, *_QUATERNION, _PARENT, _CHILD)
_FRAME = re.compile(r"[^\s\"'`$\\/&|;<>()#*?~{}\[\]!-][^\s\"'`$\\&|;<>()#*?~{}\[\]!]*")


def ros1_arguments(pose: RigidTransform) -> tuple[str, ...]:
    """Return the arguments for `tf2_ros` of ROS 1."""
    values = (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist())
    return (*map(number_text, values), _frame(pose.target), _frame(pose.source))


def ros2_arguments(pose: RigidTransform) -> tuple[str, ...]:
    """Return the arguments for `tf2_ros` of ROS 2."""
    values = dict(
        zip((*_TRANSLATION, *_QUATERNION), (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist()), strict=True)
    )
    given = {name: number_text(value) for name, value in values.items()}
    given |= {_PARENT: _frame(pose.target), _CHILD: _frame(pose.source)}
    return tuple(word for name, value in given.items() for word in (f"--{name}", value))


def node_name(pose: RigidTransform) -> str:
    """Return a valid name of a ROS node that publishes the pose."""
    return "static_transform_" + re.sub(r"\W", "_", pose.source, flags=re.ASCII)


def split_arguments(text: str) -> list[str]:
    """Return the words of a command; raise ValueError, with a clause, if it is none."""
    if len(text) > _MAX_COMMAND:
        raise ValueError(f"it has a command of more than {_MAX_COMMAND} characters")
    return shlex.split(text, comments=True)


def pose_of_arguments(package: str, arguments: Sequence[str]) -> RigidTransform:
    """Return ``T_parent_child`` of the arguments of a node; raise ValueError, with a clause, if they are wrong."""
    words = list(arguments)
    if "--ros-args" in words:
        words = words[: words.index("--ros-args")]
    if any("$(" in word for word in words):
        raise ValueError(f"'{' '.join(words)}' has a substitution; expected numbers and frames")
    if any(word.startswith("--") for word in words):
        return _named(words)
    if package == _LEGACY_PACKAGE:
        words = words[:-1]
    if len(words) not in (8, 9):
        raise ValueError(f"'{' '.join(arguments)}' has {len(arguments)} arguments; expected 6 or 7 numbers, two frames")
    *values, parent, child = words
    xyz_m, turn = values[:3], numbers(values[3:], f"the rotation of '{child}'")
    if len(turn) == 4:
        return _pose(parent, child, xyz_m, xyzw=turn)
    return _pose(parent, child, xyz_m, rpy_rad=turn[::-1])


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
        turn = [given.get(name, "1" if name == "qw" else "0") for name in _QUATERNION]
        return _pose(parent, child, xyz_m, xyzw=numbers(turn, f"the rotation of '{child}'"))
    if any(name in given for name in _QUATERNION):
        raise ValueError(f"'{child}' has both angles and a quaternion")
    turn = [given.get(name, "0") for name in _ANGLES]
    return _pose(parent, child, xyz_m, rpy_rad=numbers(turn, f"the rotation of '{child}'"))


def _pose(
    parent: str,
    child: str,
    xyz: Sequence[str],
    *,
    xyzw: Sequence[float] = (),
    rpy_rad: Sequence[float] = (),
) -> RigidTransform:
    parent, child = parent.removeprefix("/"), child.removeprefix("/")
    if not parent or not child:
        raise ValueError("a frame has no name")
    xyz_m = numbers(xyz, f"the translation of '{child}'")
    if xyzw:
        return pose_of_quaternion(parent, child, xyz_m, xyzw)
    return pose_of_rpy(parent, child, xyz_m, rpy_rad)


def _frame(name: str) -> str:
    """Return a name that needs no quotes in shells and launch files, and does not begin with a slash or dash."""
    if not _FRAME.fullmatch(name):
        raise UsageError(f"A ROS launch file cannot have the frame '{name}'; rename the LiDAR or give --frames ids.")
    return name
