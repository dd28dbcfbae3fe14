# SPDX-License-Identifier: Apache-2.0
"""Simulated data in the layouts of the data sets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.simulate import Simulation, simulate_snapshot
from multilica.snapshot import Scan
from tests.cli.support import write_pcd

FOLDERS = {"Ouster": "ouster", "Velodyne": "velodyne", "Avia": "livox", "Aeva": "aeva"}
"""Folder of HeLiPR -> LiDAR of the simulated rig."""
DELAYS_NS = {"Ouster": 0, "Velodyne": 13_000_000, "Avia": 37_000_000, "Aeva": 61_000_000}
START_NS = 1_691_936_556_500_000_000
"""Between the two stops the points of the Aeva get an intensity."""
PERIOD_NS = 100_000_000
FIRST_STOP, DRIVE, SECOND_STOP = 14, 6, 10
"""Scans of each part of a sequence."""
KEEP_EVERY = 5
LAYOUTS = {
    "Ouster": "<f4 x,<f4 y,<f4 z,<f4 intensity,<u4 t,<u2 reflectivity,<u2 ring,<u2 ambient",
    "Velodyne": "<f4 x,<f4 y,<f4 z,<f4 intensity,<u2 ring,<f4 time",
    "Avia": "<f4 x,<f4 y,<f4 z,<u1 intensity,<u1 tag,<u1 line,<u4 offset_time",
    "Aeva": "<f4 x,<f4 y,<f4 z,<f4 intensity,<f4 velocity,<i4 time_offset_ns,<u1 line_index",
    "Aeva after": "<f4 x,<f4 y,<f4 z,<f4 reflectivity,<f4 velocity,<i4 time_offset_ns,<u1 line_index,<f4 intensity",
}


def packed(lidar: str, stamp_ns: int, points_m: np.ndarray, intensity: float = 7.0, ring: int = 5) -> bytes:
    """Points as HeLiPR's files have them; fields other than the coordinates, the intensity and the ring hold noise."""
    late = lidar == "Aeva" and stamp_ns > 1691936557946849179
    columns = [entry.split() for entry in LAYOUTS["Aeva after" if late else lidar].split(",")]
    records = np.zeros(len(points_m), np.dtype([(name, kind) for kind, name in columns]))
    rng = np.random.default_rng(0)
    for name in records.dtype.names or ():
        records[name] = rng.integers(1, 100, len(records))
    for axis, name in enumerate("xyz"):
        records[name] = points_m[:, axis]
    records["intensity"] = intensity
    records[next(name for name in ("ring", "line", "line_index") if name in records.dtype.names)] = ring
    return records.tobytes()


@cache
def _simulated(scene: str, frames: int, disturbances: tuple[str, ...]) -> Simulation:
    return simulate_snapshot(
        "helipr", scene, 3, frames=frames, disturbances=disturbances, build_seed=3, sensors="ideal"
    )


def true_extrinsics() -> Extrinsics:
    """The truth of every part, with the names of the folders."""
    truth = _simulated("street", FIRST_STOP, ()).truth
    return Extrinsics(
        "base",
        {
            folder: RigidTransform("base", folder, truth.between("base", name).matrix)
            for folder, name in FOLDERS.items()
        },
    )


def write_helipr(folder: Path, *, with_poses: Sequence[str] = tuple(FOLDERS), stops: bool = True) -> Path:
    """A sequence that stands in a street, drives, and stands in a car park; or one that only drives."""
    street = _simulated("street", FIRST_STOP, ())
    drive = _simulated("street", DRIVE if stops else FIRST_STOP, ("moving",))
    park = _simulated("parking", SECOND_STOP, ())
    parts = [street, drive, park] if stops else [drive]
    poses = _world_poses(stops=stops)
    times_ns = [START_NS + index * PERIOD_NS for index in range(len(poses))]
    labels = []
    for name, lidar in FOLDERS.items():
        scans = [scan for part in parts for scan in part.snapshot[lidar].scans]
        stamps_ns = [time_ns + DELAYS_NS[name] for time_ns in times_ns]
        (folder / "LiDAR" / name).mkdir(parents=True)
        for scan, stamp_ns in zip(scans, stamps_ns, strict=True):
            _write_scan(folder / "LiDAR" / name, name, stamp_ns, scan)
        label = "livox_avia" if name == "Avia" else name.lower()
        labels += [(stamp_ns, label) for stamp_ns in stamps_ns]
    (folder / "stamp.csv").write_text("".join(f"{stamp},{label}\n" for stamp, label in sorted(labels)))
    for name in with_poses:
        _write_poses(folder / "LiDAR_GT" / f"{name}_gt.txt", name, times_ns, poses)
    return folder


def _write_scan(folder: Path, name: str, stamp_ns: int, scan: Scan) -> None:
    (folder / f"{stamp_ns}.bin").write_bytes(packed(name, stamp_ns, scan.points_m[::KEEP_EVERY]))


def _world_poses(*, stops: bool) -> list[RigidTransform]:
    """`T_world_base` per scan: at rest, 3 m/s along the vehicle's own heading, at rest 30 m on."""
    yaw_rad = math.radians(200.0)
    counts = (FIRST_STOP, DRIVE, SECOND_STOP) if stops else (0, FIRST_STOP, 0)
    ways_m = [0.0] * counts[0] + [0.3 * index for index in range(1, counts[1] + 1)] + [30.0] * counts[2]
    heading = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
    return [
        RigidTransform.from_xyz_rpy("world", "base", (350.0 + way_m * heading).tolist(), (0.01, -0.02, yaw_rad))
        for way_m in ways_m
    ]


def _write_poses(path: Path, name: str, times_ns: Sequence[int], poses: Sequence[RigidTransform]) -> None:
    """Poses of one LiDAR at its own stamps, and just before and after its scans."""
    T_base_lidar = true_extrinsics().between("base", name)
    around = [
        (times_ns[0] - PERIOD_NS, poses[0]),
        *((time_ns + DELAYS_NS[name], pose) for time_ns, pose in zip(times_ns, poses, strict=True)),
        (times_ns[-1] + 2 * PERIOD_NS, poses[-1]),
    ]
    lines = []
    for stamp_ns, pose in around:
        at = pose @ T_base_lidar
        numbers = " ".join(f"{value:.12f}" for value in (*at.xyz_m, *at.quaternion_xyzw))
        lines.append(f"{stamp_ns} {numbers}\n")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(lines))


@cache
def _sides() -> Simulation:
    return simulate_snapshot("sides", "street", 2, frames=1, sensors="ideal")


def write_opencalib(folder: Path, *, keep_every: int = 2) -> Extrinsics:
    """A scene of the `sides` rig as OpenCalib's example has it; returns its truth."""
    simulation = _sides()
    lines = []
    for index, name in enumerate(("top", "left", "right")):
        file = f"{name}-2022-02-15-17-36-04-4{index}4.pcd"
        write_pcd(folder / file, simulation.snapshot[name].scans[0].points_m[::keep_every])
        lines.append(f"device_id: {index}\npath: data/{folder.name}/{file}\n")
    (folder / "lidar_cloud_path.txt").write_text("".join(lines))
    (folder / "initial_extrinsic.txt").write_text("device_id: 0\n(Roll,Pitch,Yaw,tx,ty,tz): 0 0 0 0 0 0\n")
    return simulation.truth


def truth_yaml(truth: Extrinsics, target: str, names: dict[str, str], *, quaternions: bool = False) -> str:
    """The truth as the authors publish it: LiDAR -> its name there, relative to the target."""
    lines = ["ground_truth:"]
    for lidar, name in names.items():
        pose = truth.between(target, lidar)
        values = (*pose.xyz_m, *(pose.quaternion_xyzw if quaternions else pose.rpy_deg))
        lines.append(f"  {name}: [{', '.join(f'{value:.12f}' for value in values)}] ")
    return "\n".join([*lines, "", "# [deg] x y z r p y", "calibration:", "  lidar_1: [1, 2, 3, 4, 5, 6]", ""])
