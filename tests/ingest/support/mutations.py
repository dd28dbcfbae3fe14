# SPDX-License-Identifier: Apache-2.0
"""Files damaged by seed, and what reading them may do: give points, or refuse in one sentence."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import zstandard
from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from multilica.config import IngestConfig
from multilica.errors import MultilicaError
from multilica.geometry import RigidTransform
from multilica.ingest import inspect_source, read_snapshot
from multilica.ingest.message_types import OUSTER, is_installed
from multilica.sinks.snapshots import window_metadata, write_snapshot_mcap
from multilica.snapshot import Scan, Snapshot
from tests.ingest.support.format_writers import (
    POINT_WRITERS,
    livox_messages,
    velodyne_messages,
    write_foxglove_json,
    write_foxglove_sdk,
    write_raw_mcap,
)
from tests.ingest.support.recording_writers import make_snapshot, write_mcap, write_ros1_bag, write_ros2_bag

HANG_S = 10
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


def _bag(storage: StoragePlugin, compression: CompressionMode) -> Callable[[Snapshot, Path], None]:
    def write(snapshot: Snapshot, path: Path) -> None:
        folder = path.with_name(f"{path.name}.folder")
        write_ros2_bag(snapshot, folder, storage, compression)
        next(file for file in folder.iterdir() if file.suffix != ".yaml").rename(path)

    return write


def _packed(write: Callable[[Snapshot, Path], None]) -> Callable[[Snapshot, Path], None]:
    def pack(snapshot: Snapshot, path: Path) -> None:
        write(snapshot, path)
        path.write_bytes(zstandard.compress(path.read_bytes()))

    return pack


def _ascii_pcd(snapshot: Snapshot, path: Path) -> None:
    rows = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in snapshot.lidars[0].scans[0].points_m)
    path.write_bytes(_pcd_head(snapshot, b"ascii") + rows.encode())


def _binary_pcd(snapshot: Snapshot, path: Path) -> None:
    path.write_bytes(_pcd_head(snapshot, b"binary") + snapshot.lidars[0].scans[0].points_m.tobytes())


def _pcd_head(snapshot: Snapshot, storage: bytes) -> bytes:
    count = str(len(snapshot.lidars[0].scans[0].points_m)).encode()
    return b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH %b\nHEIGHT 1\nDATA %b\n" % (count, storage)


def _ply(snapshot: Snapshot, path: Path) -> None:
    points_m = snapshot.lidars[0].scans[0].points_m
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points_m)}\n{properties}end_header\n"
    path.write_bytes(head.encode() + points_m.tobytes())


def _ouster(_: Snapshot, path: Path) -> None:
    from tests.ingest.support.ouster_writers import frame_of, ouster_messages, sensor

    info = sensor(columns=512)
    write_raw_mcap(ouster_messages(info, [frame_of(info, 0)]), path, "cdr")


def _recorded(snapshot: Snapshot, path: Path) -> None:
    write_snapshot_mcap(snapshot, path, metadata=window_metadata(IngestConfig(frames=2)))


def _with_transforms(snapshot: Snapshot, path: Path) -> None:
    """Static transforms, without checksums that would hide most changes."""
    pose = RigidTransform.from_xyz_rpy("base", "lidar_1", [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    with_pose = replace(snapshot, static_transforms=(pose,))
    write_mcap(with_pose, path, compression=CompressionType.NONE, checked=False)


def _first_scan(write: Callable[[Scan, Path], None]) -> Callable[[Snapshot, Path], None]:
    return lambda snapshot, path: write(snapshot.lidars[0].scans[0], path)


SEEDS: dict[str, Callable[[Snapshot, Path], None]] = {
    "zstd.mcap": write_mcap,
    "lz4.mcap": lambda snapshot, path: write_mcap(snapshot, path, compression=CompressionType.LZ4),
    "plain.mcap": lambda snapshot, path: write_mcap(snapshot, path, compression=CompressionType.NONE),
    "unindexed.mcap": lambda snapshot, path: write_mcap(snapshot, path, indexed=False),
    "unchunked.mcap": lambda snapshot, path: write_mcap(snapshot, path, chunked=False, indexed=False),
    "unchecked.mcap": lambda snapshot, path: write_mcap(
        snapshot, path, compression=CompressionType.NONE, checked=False
    ),
    "transforms.mcap": _with_transforms,
    "foxglove.mcap": write_foxglove_sdk,
    "json.mcap": lambda snapshot, path: write_foxglove_json(snapshot, path, CompressionType.NONE),
    "livox.mcap": lambda snapshot, path: write_raw_mcap(
        livox_messages(snapshot, "livox_ros_driver2", "cdr"), path, "cdr"
    ),
    "velodyne.mcap": lambda _, path: write_raw_mcap(velodyne_messages("ros1"), path, "ros1"),
    "recorded.mcap": _recorded,
    "plain.bag": write_ros1_bag,
    "lz4.bag": lambda snapshot, path: write_ros1_bag(snapshot, path, Ros1Writer.CompressionFormat.LZ4),
    "bz2.bag": lambda snapshot, path: write_ros1_bag(snapshot, path, Ros1Writer.CompressionFormat.BZ2),
    "plain.db3": _bag(StoragePlugin.SQLITE3, CompressionMode.NONE),
    "messages.db3": _bag(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "packed.db3.zstd": _bag(StoragePlugin.SQLITE3, CompressionMode.FILE),
    "packed.mcap.zst": _packed(write_mcap),
    "packed.bag.zst": _packed(write_ros1_bag),
    "ascii.pcd": _ascii_pcd,
    "binary.pcd": _binary_pcd,
    "binary.ply": _ply,
    **({"ouster.mcap": _ouster} if is_installed(OUSTER) else {}),
    **{name: _first_scan(write) for name, write in POINT_WRITERS.items()},
}
"""Name of the reader's file -> writer of one that is whole."""


def write_seed(name: str, folder: Path) -> Path:
    """A small whole file, and the place to put damaged ones."""
    path = folder / name
    SEEDS[name](make_snapshot(lidars=2, frames=2, points=30), path)
    return path


def mutated(content: bytes, generator: np.random.Generator) -> bytes:
    """One to four changes: bits, bytes, numbers that are too large, pieces lost, moved, repeated, or the end."""
    changed = bytearray(content)
    for _ in range(int(generator.integers(1, 5))):
        size = max(1, len(changed))
        place = int(generator.integers(size))
        length = int(min(size - place, generator.integers(1, 64)))
        kind = int(generator.integers(7))
        if kind == 0:
            changed[place : place + 1] = bytes([changed[place] ^ 1 << int(generator.integers(8))] if changed else [])
        elif kind == 1:
            changed[place : place + length] = generator.bytes(length)
        elif kind == 2:
            width = int(generator.choice([1, 2, 4, 8]))
            number = int(generator.choice(np.array(_NUMBERS, object))) & ((1 << 8 * width) - 1)
            changed[place : place + width] = number.to_bytes(width, "little")
        elif kind == 3:
            del changed[place : place + length]
        elif kind == 4:
            changed[place:place] = changed[place : place + length]
        elif kind == 5:
            other = int(generator.integers(size))
            changed[place : place + length] = changed[other : other + length]
        else:
            del changed[place:]
    return bytes(changed)


def read_or_refuse(path: Path, *, inspect: bool = False) -> Snapshot | None:
    """A snapshot of finite points, or None where a MultilicaError of one line says why not; nothing else may happen."""
    refusal = ""
    snapshot = None
    with _limited():
        try:
            snapshot = read_snapshot(path)
            if inspect:
                inspect_source(path)
        except MultilicaError as error:
            refusal = str(error)
    assert "\n" not in refusal
    for lidar in snapshot.lidars if snapshot else ():
        assert lidar.scans
        assert all(np.isfinite(scan.points_m).all() for scan in lidar.scans)
    return snapshot


@contextmanager
def _limited() -> Iterator[None]:
    """Raise TimeoutError where reading takes too long."""
    before = signal.signal(signal.SIGALRM, _stop)
    signal.alarm(HANG_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _stop(*_: object) -> None:
    raise TimeoutError(f"reading took more than {HANG_S} s")
