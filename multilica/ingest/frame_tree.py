# SPDX-License-Identifier: Apache-2.0
"""Frames that joints hold together."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from multilica.geometry import RigidTransform

__all__ = ["FrameTree", "Joint", "Sight"]


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """What holds a child frame to its parent.

    Args:
        T_parent_child: the pose, at rest where the joint moves.
        name: for messages; "" where the format has none.
        kind: ``"fixed"``, or how it moves.
    """

    T_parent_child: RigidTransform
    name: str = ""
    kind: str = "fixed"


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A frame as seen from another one.

    Args:
        T_target_source: its pose, with every joint at rest.
        moving: the first joint on the way that is not fixed; None if the pose holds at all times.
    """

    T_target_source: RigidTransform
    moving: Joint | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameTree:
    """Frames by their joints; it may fall into several trees."""

    joints: tuple[Joint, ...]

    @property
    def frames(self) -> tuple[str, ...]:
        """Names in order."""
        ends = (end for joint in self.joints for end in (joint.T_parent_child.target, joint.T_parent_child.source))
        return tuple(sorted(set(ends)))

    def seen_from(self, frame: str) -> dict[str, Sight]:
        """Every frame that joints connect with that one, itself included; over the fewest joints."""
        seen = {frame: Sight(RigidTransform.identity(frame, frame))}
        ways = self._ways()
        queue = deque([frame])
        while queue:
            here = queue.popleft()
            for step, joint in ways.get(here, ()):
                if step.source not in seen:
                    moving = seen[here].moving or (None if joint.kind == "fixed" else joint)
                    seen[step.source] = Sight(seen[here].T_target_source @ step, moving)
                    queue.append(step.source)
        return seen

    def _ways(self) -> dict[str, list[tuple[RigidTransform, Joint]]]:
        """Per frame the poses of its neighbours."""
        ways: dict[str, list[tuple[RigidTransform, Joint]]] = {}
        for step, joint in self._both_ways():
            ways.setdefault(step.target, []).append((step, joint))
        return ways

    def _both_ways(self) -> Iterator[tuple[RigidTransform, Joint]]:
        for joint in self.joints:
            yield joint.T_parent_child, joint
            yield joint.T_parent_child.inverse(), joint
