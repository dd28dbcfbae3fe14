# SPDX-License-Identifier: Apache-2.0
"""Graph of the views of a drive: a LiDAR has one pose on the vehicle, so that what one stop tells holds at all."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import DriveView, LinkedStops, ViewPair


@dataclass(frozen=True, slots=True, eq=False)
class ViewGraph:
    """Views with the pairs that link them, and the poses that follow.

    A pair within a stop tells the pose of a LiDAR on the vehicle, which is the same at every stop. One between stops
    tells the motion of the vehicle, where the poses of its LiDARs are known.
    """

    views: Sequence[DriveView]
    _groups: dict[DriveView, dict[DriveView, FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(cls, views: Sequence[DriveView], pairs: Iterable[ViewPair]) -> "ViewGraph":
        """Link views by pairs, the ones with the most evidence first, then by LiDARs that one stop connects."""
        graph = cls(views, {view: {view: np.eye(4)} for view in views})
        for pair in sorted(pairs, key=_order):
            graph._join(pair.target, pair.source, pair.registration.T_target_source.matrix)
        while graph._carry_over():
            pass
        return graph

    def implied(self, target: DriveView, source: DriveView) -> RigidTransform | None:
        """Return the pose between two views, with their labels as frames; None if nothing links them."""
        matrix = self._matrix(target, source)
        return None if matrix is None else _pose(target.label, source.label, matrix)

    def _matrix(self, target: DriveView, source: DriveView) -> FloatArray | None:
        group = self._groups[target]
        return _inverse(group[target]) @ group[source] if source in group else None

    def group_of(self, view: DriveView) -> DriveView:
        """Return the first view of the group of a view."""
        return min(self._groups[view])

    @property
    def is_determined(self) -> bool:
        """True if the poses of all LiDARs on the vehicle follow."""
        lidars = {view.lidar for view in self.views}
        return self.lidar_poses(min(lidars)).keys() == lidars

    def lidar_poses(self, root: str) -> dict[str, RigidTransform]:
        """Return ``T_root_lidar`` of each LiDAR whose pose follows from that of the root, itself included."""
        poses = {root: np.eye(4)}
        # A LiDAR may be connected to the root through another one, at a stop where the root saw nothing.
        for known in (reached := [root]):
            for here in (view for view in self.views if view.lidar == known):
                for there in (view for view in self._groups[here] if view.stop == here.stop):
                    if there.lidar not in poses:
                        group = self._groups[here]
                        poses[there.lidar] = poses[known] @ _inverse(group[here]) @ group[there]
                        reached.append(there.lidar)
        return {name: _pose(root, name, matrix) for name, matrix in sorted(poses.items())}

    def linked_stops(self, root: str, links: Sequence[ViewPair]) -> LinkedStops:
        """Return the poses of the vehicle at the stops that links connect to others.

        Args:
            links: those that count; their LiDARs have poses relative to the root.
        """
        poses = self.lidar_poses(root)
        found: dict[str, RigidTransform] = {}
        first: dict[DriveView, tuple[str, FloatArray]] = {}
        used = [link for link in links if link.registration.lidars <= {*poses}]
        stops = {stop for link in used for stop in link.stops}
        for view in self.views:
            if view.stop not in stops or view.stop in found or view.lidar not in poses:
                continue
            group = self._groups[view]
            if not any(link.target in group for link in used):
                continue
            of_root = group[view] @ _inverse(poses[view.lidar].matrix)
            _, of_first = first.setdefault(min(group), (view.stop, of_root))
            found[view.stop] = _pose(root, root, _inverse(of_first) @ of_root)
        return LinkedStops(used, found, frozenset(stop for stop, _ in first.values()))

    def _join(self, target: DriveView, source: DriveView, pose: FloatArray) -> bool:
        """Join two groups by a pose between members; return whether they were apart."""
        kept, added = self._groups[target], self._groups[source]
        if kept is added:
            return False
        if min(added) < min(kept):
            kept, added, target, source, pose = added, kept, source, target, _inverse(pose)
        T_root_added = kept[target] @ pose @ _inverse(added[source])
        kept.update({view: T_root_added @ member for view, member in added.items()})
        self._groups.update(dict.fromkeys(added, kept))
        return True

    def _carry_over(self) -> bool:
        """Join views of one stop whose LiDARs another stop connects; return whether any were apart."""
        for one, other in self._of_one_stop():
            if (pose := self._matrix(one, other)) is None:
                continue
            for stop in sorted({view.stop for view in self.views}):
                ends = DriveView(one.lidar, stop), DriveView(other.lidar, stop)
                if {*ends} <= self._groups.keys() and self._join(*ends, pose):
                    return True
        return False

    def _of_one_stop(self) -> list[tuple[DriveView, DriveView]]:
        return [
            (one, other)
            for one in self.views
            for other in self.views
            if one.stop == other.stop and one.lidar < other.lidar
        ]


def _inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transform (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def _pose(target: str, source: str, matrix: FloatArray) -> RigidTransform:
    return RigidTransform.from_rotation_translation(target, source, matrix[:3, :3], matrix[:3, 3])


def _order(pair: ViewPair) -> tuple[bool, float, DriveView, DriveView]:
    return not pair.registration.verdict.accepted, -pair.registration.evidence, pair.target, pair.source
