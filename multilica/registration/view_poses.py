# SPDX-License-Identifier: Apache-2.0
"""Poses of views out of those of LiDARs and stops, with their derivatives."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.geometry import FloatArray, RigidTransform, rotation_vector, skew
from multilica.registration.poses import moved
from multilica.results import DriveView, IndexArray, ViewPair

UNKNOWN = np.repeat([3.0, 30.0], 3)
"""(6,) standard deviations of a pose that nothing determines: rotation (rad), translation (m)."""

# LiDARs see other surfaces, or the same ones otherwise, once the vehicle has turned by so much, rad, or if two links
# lead so much farther apart, m: what decides a pose is 10 to 20 m away.
_TURNED_RAD, _APART_M = float(np.deg2rad(30.0)), 4.0


@dataclass(frozen=True, slots=True, eq=False)
class ViewPoses:
    """Unknown poses of LiDARs and stops: the pose of a view is that of its stop times that of its LiDAR.

    Within a stop, its pose cancels. A step of all unknowns has six columns per free LiDAR, then six per free stop:
    rotation (rad), translation (m) along the axes of the root.

    Args:
        poses: per LiDAR ``T_root_lidar``.
        stops: per linked stop the root in its own frame at the first of these stops.
        free, free_stops: those with a pose to find.
        groups: the stops that links connect; those of other groups have other frames.
    """

    poses: Mapping[str, RigidTransform]
    stops: Mapping[str, RigidTransform]
    free: Sequence[str]
    free_stops: Sequence[str]
    groups: Sequence[Collection[str]] = ()

    @property
    def columns(self) -> int:
        """Number of unknowns."""
        return 6 * (len(self.free) + len(self.free_stops))

    def moved(self, step: FloatArray) -> "ViewPoses":
        """Move the unknown poses by a step (columns,)."""
        turns = step.reshape(-1, 2, 3)
        poses = {name: moved(self.poses[name], *by) for name, by in zip(self.free, turns, strict=False)}
        of_stops = turns[len(self.free) :]
        stops = {name: moved(self.stops[name], *by) for name, by in zip(self.free_stops, of_stops, strict=True)}
        return replace(self, poses={**self.poses, **poses}, stops={**self.stops, **stops})

    def pose_of(self, view: DriveView, *, within: bool) -> RigidTransform:
        """Return the pose of a view; for a pair within a stop that of its LiDAR."""
        own = self.poses[view.lidar]
        return own if within else self.stops[view.stop] @ own

    def offset(self, pair: ViewPair) -> FloatArray:
        """Return the offset (6,) of the poses from the pair: rotation, translation along the target's axes."""
        target, source = (self.pose_of(view, within=not pair.is_link) for view in (pair.target, pair.source))
        return (target.inverse() @ source).offset_from(pair.registration.T_target_source)

    def jacobian(self, pair: ViewPair) -> tuple[FloatArray, IndexArray]:
        """Return the derivatives (6, 6 U) of the offset by the U unknown poses of a pair, and their columns (6 U,)."""
        target, source = (self.pose_of(view, within=not pair.is_link) for view in (pair.target, pair.source))
        to_target, zero = target.rotation.T, np.zeros((3, 3))
        apart = skew(source.xyz_m - target.xyz_m)
        by_target = np.block([[-to_target, zero], [to_target @ apart, -to_target]])
        by_source = np.block([[to_target, zero], [zero, to_target]])
        found: dict[int, FloatArray] = {}
        for view, block in ((pair.target, by_target), (pair.source, by_source)):
            for column, by_unknown in self._by_unknowns(view, block, within=not pair.is_link):
                found[column] = found[column] + by_unknown if column in found else by_unknown
        columns = np.concatenate([column + np.arange(6) for column in found])
        return np.hstack(list(found.values())), columns

    def likeness(self, one: ViewPair, other: ViewPair) -> float:
        """Return how much of their systematic errors two pairs of the same LiDARs have in common, from 0 to 1.

        A vehicle that drives straight on sees the same road, rails and walls from the same side at each stop. Stops
        that are not linked do not tell of it.
        """
        ends = (other.target, other.source), (other.source, other.target)
        views = one.target, one.source
        alike = [self._likeness(views, each) for each in ends if _lidars_of(views) == _lidars_of(each)]
        return max(alike, default=0.0)

    def _likeness(self, views: tuple[DriveView, DriveView], others: tuple[DriveView, DriveView]) -> float:
        stops = {view.stop for view in (*views, *others)}
        if not any(stops <= {*group} for group in self.groups):
            return 0.0
        turns = [
            rotation_vector(self.stops[one.stop].rotation.T @ self.stops[other.stop].rotation)
            for one, other in zip(views, others, strict=True)
        ]
        ways = [self.stops[target.stop].inverse() @ self.stops[source.stop] for target, source in (views, others)]
        turned = np.linalg.norm(turns) / _TURNED_RAD
        apart = np.linalg.norm(ways[0].xyz_m - ways[1].xyz_m) / _APART_M
        return float(np.exp(-0.5 * (turned**2 + apart**2)))

    def _by_unknowns(self, view: DriveView, by_view: FloatArray, *, within: bool) -> list[tuple[int, FloatArray]]:
        """Turn derivatives (6, 6) by motions of a view into those by its LiDAR and its stop, each with its column."""
        found, zero = [], np.zeros((3, 3))
        stop = None if within else self.stops[view.stop]
        if view.lidar in self.free:
            along = by_view if stop is None else by_view @ np.block([[stop.rotation, zero], [zero, stop.rotation]])
            found.append((6 * self.free.index(view.lidar), along))
        if stop is not None and view.stop in self.free_stops:
            arm_m = stop.rotation @ self.poses[view.lidar].xyz_m
            turned = by_view @ np.block([[np.eye(3), zero], [-skew(arm_m), np.eye(3)]])
            found.append((6 * (len(self.free) + self.free_stops.index(view.stop)), turned))
        return found


def _lidars_of(views: tuple[DriveView, DriveView]) -> list[str]:
    return [view.lidar for view in views]
