# SPDX-License-Identifier: Apache-2.0
"""Numbers, poses and trees of frames in files of extrinsics."""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from multilica.documents import MAX_YAML_BYTES, DocumentError, parse_yaml, read_limited, require_length, shown
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms import MAX_ANGLE_RAD, Joint
from multilica.sinks.files.result_files import number_list

_MAX_LISTED = 3
_MAX_FRAMES = 2000
"""Vehicles have a tenth of it."""
_MAX_BYTES = 256 << 10
"""The poses of a hundred LiDARs take a tenth of it."""
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
_WORDS = ("true", "false", "yes", "no", "on", "off", "y", "n", "null")
"""Values of YAML 1.1 that are no texts."""
_NORM_TOLERANCE = 0.01
_ROTATION_TOLERANCE = 1e-3
"""Matrices of four digits are rotations."""
_MAX_ENTRY = 2.0
"""Larger entries of a rotation are wrong, and their squares may overflow."""


def numbers(values: Sequence[object], what: str) -> list[float]:
    """Return finite numbers of a file; raise ValueError, with a clause as its text, if one of them is not."""
    try:
        found = [float(value) for value in values if not isinstance(value, bool)]  # type: ignore[arg-type]
    except (TypeError, ValueError):
        found = []
    if len(found) != len(values) or not all(map(math.isfinite, found)):
        raise ValueError(f"{what} is {shown(' '.join(map(str, values)))}; expected {len(values)} numbers")
    return found


def pose_of_rpy(parent: str, child: str, xyz_m: Sequence[float], rpy_rad: Sequence[float]) -> RigidTransform:
    """Make a pose from extrinsic xyz angles; raise ValueError if they can only be degrees."""
    if max(map(abs, rpy_rad)) > MAX_ANGLE_RAD:
        raise ValueError(f"'{child}' has the angles {number_list(rpy_rad)}; expected radians")
    return RigidTransform.from_xyz_rpy(parent, child, [require_length(length) for length in xyz_m], rpy_rad)


def pose_of_quaternion(parent: str, child: str, xyz_m: Sequence[float], xyzw: Sequence[float]) -> RigidTransform:
    """Make a pose from a quaternion; raise ValueError if it is not one of length 1."""
    norm = math.hypot(*xyzw)
    if not abs(norm - 1.0) < _NORM_TOLERANCE:
        raise ValueError(f"'{child}' has a quaternion of length {norm:.3g}; expected 1")
    return RigidTransform.from_xyz_quaternion(parent, child, [require_length(length) for length in xyz_m], xyzw)


def pose_of_matrix(parent: str, child: str, rows: Sequence[Sequence[object]]) -> RigidTransform:
    """Make a pose from the first three rows of a matrix, or all four; raise ValueError if it is not a rotation."""
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
        raise ValueError(f"'{child}' has a matrix that is not of 3 or 4 rows with 4 numbers")
    matrix = np.array([numbers(row, f"a row of the matrix of '{child}'") for row in rows])
    rotation = matrix[:3, :3]
    largest = np.abs(rotation).max()
    residual = largest if largest > _MAX_ENTRY else np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (residual <= _ROTATION_TOLERANCE and np.linalg.det(rotation) > 0.0):
        raise ValueError(f"'{child}' has a matrix that is not a rotation: it is off by {residual:.2g}")
    if len(matrix) == 4 and matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"'{child}' has a matrix with the last row {number_list(matrix[3])}; expected 0 0 0 1")
    xyz_m = [require_length(length) for length in matrix[:3, 3].tolist()]
    return RigidTransform.from_rotation_translation(parent, child, rotation, xyz_m)


def quoted(text: str) -> str:
    """Return a text as a scalar of YAML, in quotes where it could be something else."""
    return text if _PLAIN.fullmatch(text) and text.lower() not in _WORDS else json.dumps(text, ensure_ascii=False)


def read_text(path: Path) -> str:
    """Read a small UTF-8 text file.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: not such a file.
    """
    try:
        return read_limited(path, _MAX_BYTES).decode("utf-8-sig")
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No extrinsics file at {path}.") from error
    except UnicodeDecodeError as error:
        raise UnreadableSourceError(f"{path} is not a UTF-8 text file.") from error
    except (OSError, DocumentError) as error:
        raise UnreadableSourceError(f"{path} cannot be read: {error}.") from error


def mapping_of(value: object, what: str) -> Mapping[str, Any]:
    """Return a value that is a table with texts as keys; raise ValueError if it is not."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{what} is {shown(value)}; expected a table")
    return value


def read_yaml(path: Path) -> Mapping[str, Any]:
    """Read a YAML file with a table; raise ValueError, with a clause as its text, if it is not one."""
    return mapping_of(parse_yaml(read_limited(path, MAX_YAML_BYTES)), "the document")


def extrinsics_of_tree(edges: Iterable[RigidTransform | Joint]) -> Extrinsics:
    """Return the pose of every frame of a tree in its root, with every joint at rest.

    Args:
        edges: joints, or the ``T_parent_child`` of fixed ones.

    Raises:
        ValueError: there are no frames, a cycle, two roots, or two parents of a frame; the text is a clause.
    """
    above = _joint_above(edge if isinstance(edge, Joint) else Joint(edge) for edge in edges)
    if not above:
        raise ValueError("it has no transforms")
    roots = sorted({joint.T_parent_child.target for joint in above.values()} - {*above})
    if len(roots) > 1:
        more = f" and {len(roots) - _MAX_LISTED} more" if len(roots) > _MAX_LISTED else ""
        listed = ", ".join(f"'{root}'" for root in roots[:_MAX_LISTED])
        raise ValueError(f"its frames have {len(roots)} roots, {listed}{more}; expected one")
    known = {root: RigidTransform.identity(root, root) for root in roots}
    moving: dict[str, frozenset[str]] = {root: frozenset() for root in roots}
    for frame in above:
        for joint in reversed(_way_up(frame, above, known)):
            parent, child = joint.T_parent_child.target, joint.T_parent_child.source
            known[child] = known[parent] @ joint.T_parent_child
            own = () if joint.kind == "fixed" else (f"'{joint.name}', a {joint.kind} joint",)
            moving[child] = moving[parent].union(own)
    (root,) = roots
    return Extrinsics(root, {frame: known[frame] for frame in sorted(known) if frame != root}, moving)


def _joint_above(joints: Iterable[Joint]) -> dict[str, Joint]:
    """Return the joint to the parent of each frame."""
    above: dict[str, Joint] = {}
    for joint in joints:
        parent, child = joint.T_parent_child.target, joint.T_parent_child.source
        if parent == child:
            raise ValueError(f"'{child}' is its own parent")
        if child in above:
            first = above[child].T_parent_child.target
            parents = f"two parents, '{first}' and '{parent}'" if first != parent else f"two poses in '{parent}'"
            raise ValueError(f"'{child}' has {parents}; expected one")
        if len(above) == _MAX_FRAMES:
            raise ValueError(f"it has more than {_MAX_FRAMES} frames")
        above[child] = joint
    return above


def _way_up(frame: str, above: dict[str, Joint], known: dict[str, RigidTransform]) -> list[Joint]:
    """Return the joints from a frame up to the first known one."""
    way: dict[str, Joint] = {}
    while frame not in known:
        if frame in way:
            raise ValueError(f"its frames have a cycle through '{frame}'")
        way[frame] = above[frame]
        frame = above[frame].T_parent_child.target
    return list(way.values())
