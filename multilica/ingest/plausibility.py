# SPDX-License-Identifier: Apache-2.0
"""Warnings about input that is readable, yet plausibly not what its owner takes it for."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from multilica.errors import listed
from multilica.geometry import FloatArray, RigidTransform, lengths
from multilica.ingest.transforms import Joint, poses_from
from multilica.snapshot import LidarScans

_MAX_POINTS = 4000
_MIN_POINTS = 200
# The farthest LiDARs of vehicles reach 500 m, and half of the returns of any lie within a few tens of metres.
_MAX_MEDIAN_M = 300.0
_MM_PER_M = 1000.0
_M_PER_FOOT = 0.3048
_MAP_M = 1000.0
_MAP_SPREADS = 3.0
# The roof of a lorry is 4 m high; a LiDAR on a car's roof is 1.5 to 2.2 m above the ground, which is 5 to 7 feet.
_MAX_HEIGHT_M = 4.6
_MAX_HEIGHT_FEET = 15.0
_GROUND_REACH_M = 40.0
_GROUND_M = 0.1
_GROUND_SHARE = 0.15
_MAX_TILT = 0.8
_PLANES = 80
_MAX_NEAR = 1000
# Share of the points of one cloud that lie on another, by a static transform.
_NEAR_M = 0.4
_MAX_OTHERS = 12_000
_MAX_PROBES = 800
_TURNED = {axis: np.where(np.arange(3) == index, -1.0, 1.0) for index, axis in enumerate("xyz")}
_TURNED_ABOUT = (np.ones(3), *(-sign for sign in _TURNED.values()))
_MIN_MIRRORED_SHARE = 0.25
_MIN_MIRRORED_RATIO = 1.8


def plausibility_notes(lidars: Sequence[LidarScans], static_transforms: Sequence[RigidTransform] = ()) -> list[str]:
    """Return sentences on clouds that are copies, in another unit, in map coordinates or mirrored.

    Sizes are told by what every LiDAR of a vehicle has in common: its reach, and its height above the ground.
    """
    clouds_m = {lidar.name: _sample(lidar) for lidar in lidars}
    clouds_m = {name: cloud_m for name, cloud_m in clouds_m.items() if len(cloud_m) >= _MIN_POINTS}
    odd = {name: note for name, cloud_m in clouds_m.items() if (note := _extent_note(cloud_m))}
    fine_m = {name: cloud_m for name, cloud_m in clouds_m.items() if name not in odd}
    # One sentence for all LiDARs that share a kind of note.
    kinds: dict[str, list[str]] = {}
    for name, note in odd.items():
        kinds.setdefault(note.rpartition(":")[2], []).append(name)
    grouped = (f"The points of {listed(names)} {odd[names[0]]}." for names in kinds.values())
    return [*_copies(lidars), *grouped, *_feet(fine_m), *_mirrored(lidars, fine_m, static_transforms)]


def _sample(lidar: LidarScans) -> FloatArray:
    """Return up to `_MAX_POINTS` points (N, 3) of the first frame that has any, without zeros of lost beams."""
    points_m = next((scan.points_m for scan in lidar.scans if len(scan.points_m)), np.empty((0, 3), np.float32))
    points_m = points_m[points_m.any(axis=1)]
    return points_m[:: max(1, len(points_m) // _MAX_POINTS)].astype(np.float64)


def _copies(lidars: Sequence[LidarScans]) -> Iterator[str]:
    for one, other in combinations(lidars, 2):
        frames = min(len(one.scans), len(other.scans))
        same = sum(
            len(scan.points_m) >= _MIN_POINTS and np.array_equal(scan.points_m, twin.points_m)
            for scan, twin in zip(one.scans, other.scans, strict=False)
        )
        if same:
            yield (
                f"{one.name} and {other.name} have identical points in {same} of {frames} frames: one LiDAR may be "
                "recorded under two names."
            )


def _extent_note(points_m: FloatArray) -> str:
    """Return a clause on a cloud of impossible extent; empty for others."""
    middle_m = np.median(points_m, axis=0)
    distance_m, spread_m = float(np.linalg.norm(middle_m)), float(np.median(lengths(points_m - middle_m)))
    if distance_m > max(_MAP_M, _MAP_SPREADS * spread_m):
        return (
            f"lie around a place {distance_m:.0f} m from the sensor: they may be in map coordinates; expected the "
            "sensor's own frame"
        )
    median_m = float(np.median(lengths(points_m)))
    if median_m <= _MAX_MEDIAN_M:
        return ""
    unit = "millimetres or centimetres" if median_m / _MM_PER_M < _MAX_MEDIAN_M else "another unit"
    return f"are at a median range of {median_m:.0f} m, farther than LiDARs see: they may be in {unit}; expected metres"


def _feet(clouds_m: Mapping[str, FloatArray]) -> Iterator[str]:
    heights_m = {name: height_m for name, cloud_m in clouds_m.items() if (height_m := _height_m(cloud_m)) is not None}
    if heights_m and _MAX_HEIGHT_M < max(heights_m.values()) < _MAX_HEIGHT_FEET:
        name, height_m = max(heights_m.items(), key=lambda each: each[1])
        yield (
            f"{name} is {height_m:.1f} m above the ground, higher than on any vehicle: the points may be in feet "
            f"({height_m * _M_PER_FOOT:.1f} m); expected metres."
        )


def _height_m(points_m: FloatArray) -> float | None:
    """Return the height of a LiDAR above the plane with the most points below it; None if there is no such plane.

    Planes through three points at random, of normals within 37 degrees of the sensor's z axis.
    """
    near_m = points_m[(lengths(points_m) < _GROUND_REACH_M) & (points_m[:, 2] < 0.0)]
    if len(near_m) < _MIN_POINTS:
        return None
    share_near = len(near_m) / len(points_m)
    near_m = near_m[:: max(1, len(near_m) // _MAX_NEAR)]
    rng = np.random.default_rng(0)
    a, b, c = (near_m[rng.integers(len(near_m), size=_PLANES)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    sizes = lengths(normals)
    level = (sizes > 0.0) & (np.abs(normals[:, 2]) > _MAX_TILT * sizes)
    if not np.any(level):
        return None
    normals = normals[level] / sizes[level, None]
    heights_m = np.einsum("ij,ij->i", normals, a[level])
    on_plane = np.abs(near_m @ normals.T - heights_m) < _GROUND_M
    shares = share_near * on_plane.mean(axis=0)
    best = int(np.argmax(shares))
    return abs(float(heights_m[best])) if shares[best] >= _GROUND_SHARE else None


def _mirrored(
    lidars: Sequence[LidarScans], clouds_m: Mapping[str, FloatArray], static_transforms: Sequence[RigidTransform]
) -> Iterator[str]:
    """Compare each cloud with the others by the static transforms: as it is, turned about, and mirrored."""
    frames = {lidar.name: lidar.frame_id for lidar in lidars if lidar.name in clouds_m}
    joints = [Joint(pose) for pose in static_transforms]
    for name, frame in frames.items() if joints else ():
        poses = poses_from(frame, joints)
        others_m = [
            poses[other].T_target_source.apply(clouds_m[each])
            for each, other in frames.items()
            if each != name and other in poses
        ]
        if not others_m:
            continue
        joined_m = np.concatenate(others_m)
        tree = cKDTree(joined_m[:: max(1, len(joined_m) // _MAX_OTHERS)])
        probe_m = clouds_m[name][:: max(1, len(clouds_m[name]) // _MAX_PROBES)]
        # In a tunnel, a cloud that is turned about fits as well as a mirrored one, so that neither tells anything.
        plain = max(_share_near(tree, probe_m * sign) for sign in _TURNED_ABOUT)
        turned = {axis: _share_near(tree, probe_m * sign) for axis, sign in _TURNED.items()}
        axis = max(turned, key=turned.__getitem__)
        if turned[axis] > max(_MIN_MIRRORED_SHARE, _MIN_MIRRORED_RATIO * plain):
            yield (
                f"By the static transforms, the points of {name} fit those of the other LiDARs better with {axis} "
                "turned round: they may be mirrored, as in a left-handed frame."
            )


def _share_near(tree: cKDTree, points_m: FloatArray) -> float:
    distances_m, _ = tree.query(points_m, distance_upper_bound=_NEAR_M)
    return float(np.mean(np.isfinite(distances_m)))
