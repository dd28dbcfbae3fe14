# SPDX-License-Identifier: Apache-2.0
"""Frames connected by joints."""

from collections import defaultdict, deque
from dataclasses import dataclass

from multilica.geometry import RigidTransform

__all__ = ["FramePose", "FrameTree", "Joint"]


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """The connection of a child frame to its parent.

    Args:
        T_parent_child: the pose, at rest if the joint moves.
        name: for messages; empty if the format has none.
        kind: ``"fixed"``, or how it moves.
    """

    T_parent_child: RigidTransform
    name: str = ""
    kind: str = "fixed"


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """The pose of a frame relative to another one.

    Args:
        T_target_source: the pose with every joint at rest.
        moving: the first joint between them that is not fixed; None if the pose is constant.
    """

    T_target_source: RigidTransform
    moving: Joint | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameTree:
    """Frames and joints of one or several trees."""

    joints: tuple[Joint, ...]

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames, sorted."""
        ends = (end for joint in self.joints for end in (joint.T_parent_child.target, joint.T_parent_child.source))
        return tuple(sorted(set(ends)))

    def poses_from(self, frame: str) -> dict[str, FramePose]:
        """Return the pose of every frame that is connected with `frame`, itself included, over the fewest joints."""
        steps: dict[str, list[tuple[RigidTransform, Joint]]] = defaultdict(list)
        for joint in self.joints:
            for step in (joint.T_parent_child, joint.T_parent_child.inverse()):
                steps[step.target].append((step, joint))
        found = {frame: FramePose(RigidTransform.identity(frame, frame))}
        queue = deque([frame])
        while queue:
            here = queue.popleft()
            for step, joint in steps[here]:
                if step.source not in found:
                    moving = found[here].moving or (None if joint.kind == "fixed" else joint)
                    found[step.source] = FramePose(found[here].T_target_source @ step, moving)
                    queue.append(step.source)
        return found
