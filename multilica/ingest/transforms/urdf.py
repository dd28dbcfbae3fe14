# SPDX-License-Identifier: Apache-2.0
"""The joints of a vehicle's URDF description."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from multilica.documents import read_limited, require_length
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.geometry import RigidTransform

_MAX_BYTES = 4 << 20
"""A description without its meshes takes a few hundred kilobytes; as elements, each byte takes a hundred."""
_MAX_DEPTH = 64
_NAMESPACE_OF_XACRO = "wiki/xacro}"
MAX_ANGLE_RAD = 6.29
"""A full turn, rounded up: larger angles are degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """The connection of a child frame to its parent; `kind` is ``"fixed"``, or how it moves."""

    T_parent_child: RigidTransform
    name: str = ""
    kind: str = "fixed"


def read_urdf(path: Path) -> tuple[Joint, ...]:
    """Read every joint of a URDF file; ignore links without a joint and meshes.

    A joint's origin is ``T_parent_child``: xyz in metres, rpy in radians, extrinsic xyz; identity if it is missing.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is not XML or URDF, has xacro macros, or its joints are not a tree.
    """
    robot = parse_xml(path, "URDF")
    _require_shallow(robot, path)
    if path.suffix == ".xacro" or any(_NAMESPACE_OF_XACRO in str(element.tag) for element in robot.iter()):
        raise UnreadableSourceError(
            f"{path} has xacro macros; run xacro first (xacro {path.name} > robot.urdf) and give its output."
        )
    if robot.tag != "robot":
        raise UnreadableSourceError(f"{path} begins with <{robot.tag}>; expected <robot>, as in a URDF file.")
    try:
        joints = tuple(_joint(element) for element in robot.findall("joint"))
        _require_tree(joints)
    except ValueError as error:
        raise UnreadableSourceError(f"{path} is not a valid URDF file: {error}.") from error
    return joints


def parse_xml(path: Path, kind: str) -> Element:
    """Parse a small XML file without entities; `kind` is what it should be, for messages.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is not such a file.
    """
    try:
        return ElementTree.fromstring(read_limited(path, _MAX_BYTES))
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No {kind} file at {path}.") from error
    except DefusedXmlException as error:
        raise UnreadableSourceError(f"{path} defines XML entities; remove them, a {kind} file needs none.") from error
    except (OSError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise UnreadableSourceError(f"{path} is not a valid XML file: {error}.") from error


def _require_shallow(robot: Element, path: Path) -> None:
    level = [robot]
    for _ in range(_MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise UnreadableSourceError(
            f"{path} is not a valid URDF file: it is nested more than {_MAX_DEPTH} levels deep."
        )


def _joint(element: Element) -> Joint:
    name = element.get("name", "")
    kind = element.get("type")
    if kind is None:
        raise ValueError(f"joint '{name}' has no type")
    parent, child = (_link(element, end, name) for end in ("parent", "child"))
    if parent == child:
        raise ValueError(f"joint '{name}' joins '{parent}' to itself")
    origin = element.find("origin")
    xyz_m, rpy_rad = (_three(origin, key, name) for key in ("xyz", "rpy"))
    return Joint(RigidTransform.from_xyz_rpy(parent, child, xyz_m, rpy_rad), name, kind)


def _link(joint: Element, end: str, name: str) -> str:
    entry = joint.find(end)
    link = "" if entry is None else entry.get("link", "")
    if not link:
        raise ValueError(f"joint '{name}' has no {end} link")
    return link


def _three(origin: Element | None, key: str, name: str) -> list[float]:
    text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
    try:
        numbers = [require_length(float(word)) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise ValueError(f"joint '{name}' has {key} '{text}', expected three numbers")
    if key == "rpy" and max(map(abs, numbers)) > MAX_ANGLE_RAD:
        raise ValueError(f"joint '{name}' has {key} '{text}', expected radians")
    return numbers


def _require_tree(joints: tuple[Joint, ...]) -> None:
    parents = Counter(joint.T_parent_child.source for joint in joints)
    link, count = max(parents.items(), key=lambda entry: entry[1], default=("", 0))
    if count > 1:
        raise ValueError(f"link '{link}' is the child of {count} joints, expected one")
