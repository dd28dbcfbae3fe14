# SPDX-License-Identifier: Apache-2.0
"""Folders of point files, one folder of frames per LiDAR, for the throughput of their formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from multilica.registration.lazy_open3d import o3d
from multilica.snapshot import Scan, Snapshot
from tests.ingest.support.format_writers import POINT_WRITERS

FRAMES = 3

Writer = Callable[[Scan, Path], None]


def _by_open3d(**storage: bool) -> Writer:
    def write(scan: Scan, path: Path) -> None:
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(scan.points_m))
        cloud.point.intensity = o3d.core.Tensor(scan.intensity[:, None])
        assert o3d.t.io.write_point_cloud(str(path), cloud, **storage)

    return write


def _folders(file_name: str, write: Writer) -> Callable[[Snapshot, Path], None]:
    def write_all(snapshot: Snapshot, folder: Path) -> None:
        for lidar in snapshot.lidars:
            (folder / lidar.name).mkdir(parents=True)
            for number, scan in enumerate(lidar.scans[:FRAMES]):
                write(scan, folder / lidar.name / f"{number}.{file_name.partition('.')[2]}")

    return write_all


_WRITERS: dict[str, tuple[str, Writer]] = {
    "LAS 1.2": ("a.las", POINT_WRITERS["a.las"]),
    "LAZ 1.2": ("a.laz", POINT_WRITERS["a.laz"]),
    "LAZ 1.4": ("b.laz", POINT_WRITERS["b.laz"]),
    "NumPy": ("a.npy", POINT_WRITERS["a.npy"]),
    "KITTI": ("a.bin", POINT_WRITERS["a.bin"]),
    "nuScenes": ("a.pcd.bin", POINT_WRITERS["a.pcd.bin"]),
    "PCD ascii": ("a.pcd", _by_open3d(write_ascii=True)),
    "PCD binary": ("a.pcd", _by_open3d()),
    "PCD compressed": ("a.pcd", _by_open3d(compressed=True)),
    "PLY ascii": ("a.ply", _by_open3d(write_ascii=True)),
    "PLY binary": ("a.ply", _by_open3d()),
}

POINT_FILES = {name: _folders(file_name, write) for name, (file_name, write) in _WRITERS.items()}
"""Name of the format -> writer of a snapshot's first frames."""
