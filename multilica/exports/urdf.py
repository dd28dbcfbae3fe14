# SPDX-License-Identifier: Apache-2.0
"""URDF files; an update changes only the origins of joints, to the byte."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.parsers import expat

from multilica.errors import InputError, UnreadableSourceError
from multilica.exports.values import extrinsics_of_tree
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms import Joint, read_urdf
from multilica.sinks.files.result_files import child_poses, number_list

_TAG = rb"""<[^>"']*(?:"[^"]*"[^>"']*|'[^']*'[^>"']*)*>"""
_ATTRIBUTE = rb"""(?<=\s)%s\s*=\s*("[^"]*"|'[^']*')"""


@dataclass(slots=True)
class _JointPlace:
    """Byte offsets of a joint's start tag and of its origin; None without an origin."""

    start: int
    child: str = ""
    origin: int | None = None


def updated_urdf(path: Path, extrinsics: Extrinsics) -> bytes:
    """Return the file with new origins of the joints whose child links are frames of the extrinsics.

    The common frame of the extrinsics is a link of the file that keeps its place; each origin is relative to the
    joint's own parent link.

    Raises:
        UnreadableSourceError: it is not a URDF file.
        InputError: a frame has no joint, one that moves, or one that would move the common frame.
    """
    joints = read_urdf(path)
    try:
        extrinsics_of_tree(joints)
    except ValueError as error:
        raise UnreadableSourceError(f"{path} is not a valid URDF file: {error}.") from error
    origins = _origins(path, joints, extrinsics)
    data = path.read_bytes()
    if b"\0" in data:
        raise UnreadableSourceError(f"{path} is in UTF-16; convert it to UTF-8 before its joints are updated.")
    edits = [_edit(data, place, origins[place.child]) for place in _places(data) if place.child in origins]
    for start, end, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[end:]
    return data


def _origins(path: Path, joints: tuple[Joint, ...], extrinsics: Extrinsics) -> dict[str, RigidTransform]:
    """Return the new ``T_parent_child`` of each frame; parents first, because they may be updated too."""
    above = {joint.T_parent_child.source: joint for joint in joints}
    wanted = {pose.source: pose for pose in child_poses(extrinsics)}
    anchor = extrinsics.target
    if anchor not in {*above, *(joint.T_parent_child.target for joint in joints)}:
        raise InputError(
            f"{path} has no link '{anchor}', which the poses are relative to; its links with a joint: "
            f"{', '.join(sorted(above))}."
        )
    for frame in wanted:
        if frame not in above:
            raise InputError(f"{path} has no joint with the child link '{frame}'; found {', '.join(sorted(above))}.")
        if above[frame].kind != "fixed":
            raise InputError(
                f"{path} has '{above[frame].name}', a {above[frame].kind} joint, above '{frame}'; expected a fixed one."
            )
    for frame in _ancestors(anchor, above):
        if frame in wanted:
            raise InputError(
                f"{path} mounts '{anchor}' on '{frame}', so that a new pose of '{frame}' would move it; "
                f"calibrate with another target, or give the pose of '{anchor}' with --rig."
            )
    origins: dict[str, RigidTransform] = {}
    for frame in sorted(wanted, key=lambda frame: len(_ancestors(frame, above))):
        parent = above[frame].T_parent_child.target
        now = [
            replace(joint, T_parent_child=origins.get(child, joint.T_parent_child)) for child, joint in above.items()
        ]
        try:
            origins[frame] = extrinsics_of_tree(now).between(parent, anchor) @ wanted[frame]
        except InputError as error:
            raise InputError(f"{path} cannot take the pose of '{frame}': {error}") from error
    return origins


def _ancestors(frame: str, above: Mapping[str, Joint]) -> list[str]:
    """Return a frame and those that it is mounted on, up to the child of the root."""
    found = []
    while frame in above:
        found.append(frame)
        frame = above[frame].T_parent_child.target
    return found


def _places(data: bytes) -> list[_JointPlace]:
    """Find the joints of the robot; the file has no entities, which `read_urdf` refuses."""
    parser = expat.ParserCreate()
    path: list[str] = []
    places: list[_JointPlace] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if path == ["robot"] and name == "joint":
            places.append(_JointPlace(parser.CurrentByteIndex))
        elif path == ["robot", "joint"] and name == "child":
            places[-1].child = places[-1].child or attributes.get("link", "")
        elif path == ["robot", "joint"] and name == "origin" and places[-1].origin is None:
            places[-1].origin = parser.CurrentByteIndex
        path.append(name)

    def end(_: str) -> None:
        path.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(data, True)  # noqa: FBT003 - positional only
    return places


def _edit(data: bytes, place: _JointPlace, pose: RigidTransform) -> tuple[int, int, bytes]:
    """Return the bytes that change: from, to, new ones."""
    values = {b"xyz": number_list(pose.xyz_m.tolist()), b"rpy": number_list(pose.rpy_rad.tolist())}
    begin = place.start if place.origin is None else place.origin
    found = re.compile(_TAG).match(data, begin)
    if found is None:
        raise UnreadableSourceError("The URDF file has a start tag that cannot be found; convert it to UTF-8.")
    if place.origin is None:
        given = "".join(f' {key.decode()}="{text}"' for key, text in values.items())
        return found.end(), found.end(), f"<origin{given}/>".encode()
    tag = found[0]
    for key, text in values.items():
        new = b'%s="%s"' % (key, text.encode())
        tag, count = re.subn(_ATTRIBUTE % key, new, tag)
        if not count:
            at = len(tag[: -2 if tag.endswith(b"/>") else -1].rstrip())
            tag = tag[:at] + b" " + new + tag[at:]
    return found.start(), found.end(), tag
