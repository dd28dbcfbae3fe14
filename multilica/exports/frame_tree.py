# SPDX-License-Identifier: Apache-2.0
"""Extrinsics of a tree of frames."""

from collections.abc import Iterable

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms.urdf import Joint

_MAX_LISTED = 3
_MAX_FRAMES = 2000
"""Vehicles have a tenth of it."""


def extrinsics_of_poses(poses: Iterable[RigidTransform]) -> Extrinsics:
    """Return the pose of every frame of a tree in its root; `T_parent_child` of each are given.

    Raises:
        ValueError: as `extrinsics_of_joints`.
    """
    return extrinsics_of_joints(Joint(pose) for pose in poses)


def extrinsics_of_joints(joints: Iterable[Joint]) -> Extrinsics:
    """Return the pose of every frame of a tree in its root, with every joint at rest.

    Raises:
        ValueError: there are no frames, a cycle, two roots, or two parents of a frame; the text is a clause.
    """
    above = _joint_above(joints)
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
