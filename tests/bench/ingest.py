# SPDX-License-Identifier: Apache-2.0
"""How fast each format is read, what a window of a large log costs, and what a damaged end does."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode

from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.damaged_tails import claims_on_tails
from tests.bench.support.point_files import POINT_FILES
from tests.ingest.support.format_writers import livox_messages, write_foxglove_json, write_foxglove_sdk, write_raw_mcap
from tests.ingest.support.recording_writers import (
    CLOUD,
    PERIOD_NS,
    START_NS,
    cloud_message,
    ros2_types,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

FRAMES, POINTS = 20, 65_536
CHUNK_BYTES = 4 << 20
ROUNDS = 3
JUDGED = (
    "ros2 none.mcap",
    "ros2 lz4.mcap",
    "ros2 zstd.mcap",
    "ros1 zstd.mcap",
    "unindexed zstd.mcap",
    "cut off zstd.mcap",
    "foxglove protobuf.mcap",
    "foxglove json lz4.mcap",
    "livox cdr.mcap",
)
LEAST_SHARE = 0.8
LEAST_SHARE_OF_COPYING = 0.5
"""Where nothing is compressed, iterating without a look at checksums copies memory and no more."""
LARGE_BYTES = 2_000_000_000
_HEAD = """MB of messages as they are before compression, of point files as they lie on disk. bare, checked: the
iteration of `mcap` itself, which unpacks chunks and hands over the bytes of each message, without and with a look at
checksums; decoded: this reader, which looks at the checksums and makes points. The shares are of processor time over
all threads, each reader in a process of its own, in turns, which other work on the machine changes least.
"""
_STAMP_AT = 4
"""In CDR, after the four bytes that say how it is encoded."""


def _cut_off(snapshot: Snapshot, path: Path) -> None:
    """Without what a recorder writes when it is closed; large enough not to be kept in memory."""
    twice = Snapshot(
        tuple(
            LidarScans(lidar.name, (*lidar.scans, *map(_later, lidar.scans)), topic=lidar.topic)
            for lidar in snapshot.lidars
        )
    )
    _mcap(twice, path, CompressionType.ZSTD)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    last = max(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    os.truncate(path, last.chunk_start_offset + last.chunk_length + last.message_index_length)


def _later(scan: Scan) -> Scan:
    return Scan(scan.points_m, scan.stamp_ns + FRAMES * PERIOD_NS, scan.intensity)


CASES: dict[str, Callable[[Snapshot, Path], None]] = {
    "ros2 none.mcap": lambda snapshot, path: _mcap(snapshot, path, CompressionType.NONE),
    "ros2 lz4.mcap": lambda snapshot, path: _mcap(snapshot, path, CompressionType.LZ4),
    "ros2 zstd.mcap": lambda snapshot, path: _mcap(snapshot, path, CompressionType.ZSTD),
    "ros1 zstd.mcap": lambda snapshot, path: write_mcap(snapshot, path, encoding="ros1", chunk_size=CHUNK_BYTES),
    "unindexed zstd.mcap": lambda snapshot, path: write_mcap(snapshot, path, indexed=False, chunk_size=CHUNK_BYTES),
    "cut off zstd.mcap": _cut_off,
    "foxglove protobuf.mcap": write_foxglove_sdk,
    "foxglove json lz4.mcap": write_foxglove_json,
    "livox cdr.mcap": lambda snapshot, path: write_raw_mcap(
        livox_messages(snapshot, "livox_ros_driver2", "cdr"), path, "cdr"
    ),
    "none.bag": write_ros1_bag,
    "lz4.bag": lambda snapshot, path: write_ros1_bag(snapshot, path, Ros1Writer.CompressionFormat.LZ4),
    "bz2.bag": lambda snapshot, path: write_ros1_bag(_head(snapshot), path, Ros1Writer.CompressionFormat.BZ2),
    "ros2 sqlite3": write_ros2_bag,
    "ros2 sqlite3 zstd messages": lambda snapshot, path: write_ros2_bag(
        snapshot, path, compression=CompressionMode.MESSAGE
    ),
    "ros2 sqlite3 zstd file": lambda snapshot, path: write_ros2_bag(snapshot, path, compression=CompressionMode.FILE),
    **POINT_FILES,
}
"""Name of the file -> its writer; whole clouds of 26 bytes a point unless the format has its own layout."""


@dataclass(frozen=True, slots=True)
class _Reading:
    """One file, read from front to end."""

    size: int
    points: int
    elapsed_s: float
    processor_s: float

    @property
    def rate(self) -> str:
        """Megabytes per second."""
        return f"{self.size / 1e6 / self.elapsed_s:.0f}"


def main() -> bool:
    """Print both tables, and whether what is expected of them holds."""
    with tempfile.TemporaryDirectory() as folder:
        claims = _throughput(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        claims += _window(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        claims += claims_on_tails(Path(folder))
    return print_claims(claims)


def _throughput(folder: Path) -> list[Claim]:
    print(_HEAD)
    snapshot = _snapshot()
    rows, claims = [], []
    for name, write in CASES.items():
        path = folder / name.replace(" ", "_")
        write(snapshot, path)
        row, strict_share, share = _throughput_row(name, path)
        rows.append(row)
        if name in JUDGED:
            what = f"decoding {name} against iterating it, checksums in both"
            claims.append(Claim(what, f">= {LEAST_SHARE} x", f"{share:.2f} x", share >= LEAST_SHARE))
            what = f"decoding {name} against iterating it without a look at checksums"
            least = LEAST_SHARE_OF_COPYING if "none" in name else LEAST_SHARE
            claims.append(Claim(what, f">= {least} x", f"{strict_share:.2f} x", strict_share >= least))
    rates = ("bare MB/s", "checked MB/s", "decoded MB/s", "M points/s")
    print_table(("file", "MB", *rates, "bare / decoded", "checked / decoded"), rows)
    return claims


def _throughput_row(name: str, path: Path) -> tuple[tuple[str, ...], float, float]:
    """The figures as text; processor time of `mcap` without and with checksums as a share of that of decoding."""
    front = " from the front" if name.startswith("cut off") else ""
    readers = ["decoded", *([f"bare{front}", f"checked{front}"] if path.suffix == ".mcap" else [])]
    decoded, *iterated = _fastest(readers, path)
    figures = (decoded.rate, f"{decoded.points / decoded.elapsed_s / 1e6:.1f}")
    size = f"{decoded.size / 1e6:.0f}"
    if not iterated:
        return (name, size, "", "", *figures, "", ""), float("nan"), float("nan")
    bare, checked = iterated
    strict_share, share = (each.processor_s / decoded.processor_s for each in (bare, checked))
    row = (name, size, bare.rate, checked.rate, *figures, f"{strict_share:.2f}", f"{share:.2f}")
    return row, strict_share, share


def _window(folder: Path) -> list[Claim]:
    path = folder / "large.mcap"
    _write_large(path)
    command = [sys.executable, "-m", "tests.bench.support.window_read", str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    cost = json.loads(ended.stdout)
    print(f"Ten frames of two LiDARs from the middle of an MCAP file of {path.stat().st_size / 1e9:.2f} GB:\n")
    rows = [
        (what, f"{cost[f'{key}_bytes'] / 1e6:.1f}", f"{cost[f'{key}_s']:.2f}")
        for what, key in (("the snapshot", "read"), ("its hash", "hash"))
    ]
    print_table(("for", "MB read", "s"), rows)
    grown = f"{cost['grown_bytes'] / 1e6:.0f} MB, of which points {cost['points_bytes'] / 1e6:.0f} MB"
    read = f"{cost['read_bytes'] / 1e6:.0f} MB for {cost['frames_bytes'] / 1e6:.0f} MB of frames"
    return [
        Claim("memory that the window takes", "< 300 MB plus its points", grown, _fits(cost)),
        Claim("bytes read for the window", "its chunks, and a few", read, cost["read_bytes"] < _most_read(cost)),
    ]


def _fits(cost: dict[str, float]) -> bool:
    return cost["grown_bytes"] < 300e6 + cost["points_bytes"]


def _most_read(cost: dict[str, float]) -> float:
    """The frames; a chunk each at both ends, ahead, and twice two to learn the span; the index."""
    return cost["frames_bytes"] + 8 * CHUNK_BYTES


def _snapshot() -> Snapshot:
    """Two LiDARs that see noise on a grid of two millimetres, as sensors give it."""
    rng = np.random.default_rng(0)
    return Snapshot(
        tuple(
            LidarScans(
                f"lidar_{index}",
                tuple(_scan(rng, START_NS + frame * PERIOD_NS + index * 1000) for frame in range(FRAMES)),
                topic=f"/lidar_{index}/points",
            )
            for index in range(2)
        )
    )


def _scan(rng: np.random.Generator, stamp_ns: int) -> Scan:
    points_m = np.round(rng.normal(0.0, 20.0, (POINTS, 3)) * 500.0) / 500.0
    return Scan(points_m.astype(np.float32), stamp_ns, rng.integers(0, 255, POINTS).astype(np.float32))


def _head(snapshot: Snapshot) -> Snapshot:
    """A tenth of the frames: for formats that are slow to write."""
    few = FRAMES // 10
    return Snapshot(tuple(LidarScans(lidar.name, lidar.scans[:few], topic=lidar.topic) for lidar in snapshot.lidars))


def _mcap(snapshot: Snapshot, path: Path, compression: CompressionType) -> None:
    write_mcap(snapshot, path, compression=compression, chunk_size=CHUNK_BYTES)


def _fastest(readers: Sequence[str], path: Path) -> list[_Reading]:
    """Of some rounds in turns: other work on the machine only ever adds to what a reader takes."""
    rounds = [[_reading(reader, path) for reader in readers] for _ in range(ROUNDS)]
    return [
        _Reading(
            of_reader[0].size,
            of_reader[0].points,
            min(reading.elapsed_s for reading in of_reader),
            min(reading.processor_s for reading in of_reader),
        )
        for of_reader in zip(*rounds, strict=True)
    ]


def _reading(reader: str, path: Path) -> _Reading:
    command = [sys.executable, "-m", "tests.bench.support.reader_speed", reader, str(path)]
    return _Reading(**json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))


def _write_large(path: Path) -> None:
    """The same two clouds over and over, each time with another stamp."""
    rng = np.random.default_rng(0)
    store = ros2_types()
    frames = [
        bytearray(store.serialize_cdr(cloud_message(store, _scan(rng, START_NS), f"lidar_{index}"), CLOUD))
        for index in range(2)
    ]
    definition, _ = store.generate_msgdef(CLOUD, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(CLOUD, "ros2msg", definition.encode())
        channels = [writer.register_channel(f"/lidar_{index}/points", "cdr", schema) for index in range(2)]
        for number in range(LARGE_BYTES // sum(map(len, frames))):
            for channel, data in zip(channels, frames, strict=True):
                time_ns = START_NS + number * PERIOD_NS
                struct.pack_into("<II", data, _STAMP_AT, *divmod(time_ns, 10**9))
                writer.add_message(channel, time_ns, bytes(data), time_ns)
        writer.finish()
