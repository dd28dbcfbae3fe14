# SPDX-License-Identifier: Apache-2.0
"""Poses of LiDARs and stops on a plane: all that fit the headings of the pairs of views."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform
from multilica.multi_snapshot.common_ground import vertical_of
from multilica.registration.view_poses import UNKNOWN
from multilica.results import ViewPair

# A heading that pairs tell twice differs by less, and LiDARs are as level; the ground may be uneven.
_SAME_HEADING_RAD = float(np.deg2rad(10.0))
# Links are off by less in the plane, but along a road, where their own covariance says so.
_ROUGHLY_M = 0.1
# A heading that pairs tell twice over has two solutions, half a turn apart; so many in all may be told apart.
_MOST_SOLUTIONS = 64
_ZERO = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPoses:
    """One solution.

    Args:
        poses: per LiDAR ``T_root_lidar``.
        stops: per linked stop the root in its own frame at the first of these stops.
    """

    poses: Mapping[str, RigidTransform]
    stops: Mapping[str, RigidTransform]


@dataclass(frozen=True, slots=True, eq=False)
class _Levelled:
    """A pair as seen from above, its LiDARs levelled by the ground that they see.

    Args:
        heading_rad: of the source in the target's levelled frame.
        shift_m: (2,) of the source, along the axes of that frame.
        weight: (2, 2) inverse covariance of the shift.
    """

    pair: ViewPair
    heading_rad: float
    shift_m: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True)
class _Unknowns:
    """LiDARs beside the root, then stops after the first one, by their number."""

    root: str
    lidars: Sequence[str]
    first: str
    stops: Sequence[str]

    @classmethod
    def of(cls, root: str, seen: Sequence[_Levelled]) -> "_Unknowns":
        """Select the LiDARs and linked stops of pairs."""
        lidars = sorted({name for each in seen for name in each.pair.registration.lidars} - {root})
        first, *stops = sorted({stop for each in seen if each.pair.is_link for stop in each.pair.stops}) or [""]
        return cls(root, lidars, first, stops)

    def __len__(self) -> int:
        return len(self.lidars) + len(self.stops)

    def of_lidar(self, name: str) -> int | None:
        """Return the number of a LiDAR; None for the root."""
        return self.lidars.index(name) if name in self.lidars else None

    def of_stop(self, pair: ViewPair, name: str) -> int | None:
        """Return the number of a stop; None for the first one, or for a pair within a stop."""
        return len(self.lidars) + self.stops.index(name) if pair.is_link and name in self.stops else None

    def among(self, pair: ViewPair, numbers: Collection[int]) -> bool:
        """Return whether one of these unknowns is a LiDAR or a stop of the pair."""
        found = {number for view in pair.views for number in (self.of_lidar(view.lidar), self.of_stop(pair, view.stop))}
        return not found.isdisjoint(numbers)


def planar_poses(root: str, pairs: Sequence[ViewPair], grounds: Sequence[ViewPair]) -> list[PlanarPoses]:
    """Find all poses of level LiDARs and stops on a plane that fit the pairs roughly.

    Each pair tells a difference of headings. These equations are linear, with integer coefficients, but hold up to
    whole turns only: a heading that they tell twice over may be half a turn away. All solutions are found, without a
    guess. Then the positions follow by linear least squares.

    Args:
        grounds: pairs of one LiDAR with each other one that sees ground, as `ground_pairs` makes them.

    Returns:
        Poses of the LiDARs whose headings follow, and of stops; none if the root sees no ground.
    """
    levels = _levels(grounds)
    if root not in levels:
        return []
    seen, unknowns = _determined(root, [each for pair in pairs if (each := _levelled(pair, levels)) is not None])
    if not unknowns.lidars:
        return []
    return [_placed(seen, levels, unknowns, each) for each in _headings(seen, unknowns)]


def _levels(grounds: Sequence[ViewPair]) -> dict[str, tuple[FloatArray, float]]:
    """Return the rotation (3, 3) that levels each LiDAR, and its height over the first one."""
    if not grounds:
        return {}
    first = grounds[0].registration
    up = vertical_of(grounds[0])
    ahead = np.eye(3)[int(np.argmin(np.abs(up)))]
    side = np.cross(up, ahead) / np.linalg.norm(np.cross(up, ahead))
    level = np.stack([np.cross(side, up), side, up])
    others = {each.registration.source: each.registration.T_target_source for each in grounds}
    found = {name: (level @ pose.rotation, float(up @ pose.xyz_m)) for name, pose in others.items()}
    return {first.target: (level, 0.0), **found}


def _levelled(pair: ViewPair, levels: Mapping[str, tuple[FloatArray, float]]) -> _Levelled | None:
    found = pair.registration
    if not found.lidars <= levels.keys() or found.information is None:
        return None
    (of_target, _), (of_source, _) = levels[found.target], levels[found.source]
    turn = of_target @ found.T_target_source.rotation @ of_source.T
    heading_rad = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    covariance = of_target @ np.linalg.pinv(found.information, hermitian=True)[3:, 3:] @ of_target.T
    weight = np.asarray(np.linalg.inv(covariance[:2, :2] + _ROUGHLY_M**2 * np.eye(2)), dtype=np.float64)
    return _Levelled(pair, heading_rad, (of_target @ found.T_target_source.xyz_m)[:2], weight)


def _determined(root: str, seen: Sequence[_Levelled]) -> tuple[list[_Levelled], _Unknowns]:
    """Return the pairs whose headings determine those of all their LiDARs and stops."""
    left = [*seen]
    while True:
        unknowns = _Unknowns.of(root, left)
        null = np.abs(_null_space(_coefficients(left, unknowns))).max(axis=1, initial=0.0)
        loose = np.flatnonzero(null > _ZERO).tolist()
        if not loose:
            return left, unknowns
        left = [each for each in left if not unknowns.among(each.pair, loose)]


def _coefficients(seen: Sequence[_Levelled], unknowns: _Unknowns) -> FloatArray:
    """Return by how much each unknown heading counts for each pair."""
    found = np.zeros((len(seen), len(unknowns)))
    for row, each in zip(found, seen, strict=True):
        for view, sign in ((each.pair.target, -1.0), (each.pair.source, 1.0)):
            for number in (unknowns.of_lidar(view.lidar), unknowns.of_stop(each.pair, view.stop)):
                if number is not None:
                    row[number] += sign
    return found


def _null_space(coefficients: FloatArray) -> FloatArray:
    """Return vectors (N, K) of unknowns that change nothing."""
    values, vectors = np.linalg.eigh(coefficients.T @ coefficients)
    return np.asarray(vectors[:, values < _ZERO])


def _headings(seen: Sequence[_Levelled], unknowns: _Unknowns) -> list[FloatArray]:
    """Return all headings (N,) that fit the pairs."""
    coefficients = _coefficients(seen, unknowns)
    told = np.array([each.heading_rad for each in seen])
    rows = _independent(coefficients)
    inverse = np.asarray(np.linalg.inv(coefficients[rows]), dtype=np.float64)
    found = []
    for turns in _classes(inverse):
        headings = inverse @ told[rows] + 2.0 * np.pi * turns
        rest = _wrapped(told - coefficients @ headings)
        if np.abs(rest).max() < _SAME_HEADING_RAD:
            found.append(headings + np.linalg.lstsq(coefficients, rest, rcond=None)[0])
    return found


def _independent(coefficients: FloatArray) -> list[int]:
    """Return as many rows as there are unknowns that determine all of them."""
    rows: list[int] = []
    for number in range(len(coefficients)):
        if np.linalg.matrix_rank(coefficients[[*rows, number]]) > len(rows):
            rows.append(number)
    return rows


def _classes(inverse: FloatArray) -> list[FloatArray]:
    """Return all shares of a turn (N,), less than one each, that change every equation by whole turns.

    Too many solutions tell nothing: then none is returned.
    """
    found = [np.zeros(len(inverse))]
    for number in count():
        if len(found) > _MOST_SOLUTIONS:
            return []
        if number >= len(found):
            return found
        for step in inverse.T:
            further = np.mod(found[number] + step + _ZERO, 1.0) - _ZERO
            if all(np.abs(_nearest(further - known)).max() > _ZERO for known in found):
                found.append(further)
    return found


def _nearest(turns: FloatArray) -> FloatArray:
    return np.asarray(turns - np.round(turns))


def _wrapped(angles_rad: FloatArray) -> FloatArray:
    return 2.0 * np.pi * _nearest(angles_rad / (2.0 * np.pi))


def _placed(
    seen: Sequence[_Levelled],
    levels: Mapping[str, tuple[FloatArray, float]],
    unknowns: _Unknowns,
    headings: FloatArray,
) -> PlanarPoses:
    """Return the poses with those headings whose positions fit the pairs best."""
    turns = [Rotation.from_rotvec([0.0, 0.0, rad]).as_matrix() for rad in headings]
    size = 2 * len(unknowns)
    information, gradient = np.eye(size) / UNKNOWN[-1] ** 2, np.zeros(size)
    for each in seen:
        rows = np.zeros((2, size))
        for view, sign in ((each.pair.source, 1.0), (each.pair.target, -1.0)):
            lidar, stop = unknowns.of_lidar(view.lidar), unknowns.of_stop(each.pair, view.stop)
            to_root = np.eye(2) if stop is None else turns[stop][:2, :2]
            if lidar is not None:
                rows[:, 2 * lidar : 2 * lidar + 2] += sign * to_root
                to_root = to_root @ turns[lidar][:2, :2]
            if stop is not None:
                rows[:, 2 * stop : 2 * stop + 2] += sign * np.eye(2)
        weighted = rows.T @ to_root @ each.weight @ to_root.T
        information += weighted @ rows
        gradient += weighted @ to_root @ each.shift_m
    xy_m = np.linalg.solve(information, gradient).reshape(-1, 2)

    of_root, root_m = levels[unknowns.root]

    def pose(name: str, number: int, level: FloatArray, height_m: float) -> RigidTransform:
        rotation, xyz_m = turns[number] @ level, np.append(xy_m[number], height_m - root_m)
        return RigidTransform.from_rotation_translation(unknowns.root, name, of_root.T @ rotation, of_root.T @ xyz_m)

    identity = RigidTransform.identity(unknowns.root, unknowns.root)
    lidars = {name: pose(name, number, *levels[name]) for number, name in enumerate(unknowns.lidars)}
    after = enumerate(unknowns.stops, len(unknowns.lidars))
    stops = {name: pose(unknowns.root, number, of_root, root_m) for number, name in after}
    return PlanarPoses(
        {unknowns.root: identity, **lidars}, {unknowns.first: identity, **stops} if unknowns.first else {}
    )
