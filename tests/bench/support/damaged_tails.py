# SPDX-License-Identifier: Apache-2.0
"""How fast recordings are read whose end is zeros, as after a power loss, anything at all, or a hole."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from multilica.snapshot import Snapshot
from tests.bench.support.claims import Claim, print_table
from tests.ingest.support.recording_writers import make_snapshot, write_mcap, write_ros1_bag, write_ros2_bag

LEAST_MB_S = 200.0
MOST_READ_OF_HOLE = 150e6
"""The hash of a source reads parts of 134 MB together."""
REPEATS = 3
TAILS = (("zeros", 50), ("zeros", 500), ("garbage", 50), ("garbage", 500), ("hole", 8000))
"""Kind, and size in MB."""
_MB = 1_000_000
_INDEX_AT = b"index_pos="


def _bag_without_index(snapshot: Snapshot, path: Path) -> None:
    write_ros1_bag(snapshot, path)
    data = bytearray(path.read_bytes())
    at = data.index(_INDEX_AT) + len(_INDEX_AT)
    end = int.from_bytes(data[at : at + 8], "little")
    data[at : at + 8] = bytes(8)
    path.write_bytes(data[:end])


def _db3(snapshot: Snapshot, path: Path) -> None:
    folder = path.with_suffix(".folder")
    write_ros2_bag(snapshot, folder)
    next(folder.glob("*.db3")).rename(path)


WRITERS: dict[str, Callable[[Snapshot, Path], None]] = {
    "a.mcap": write_mcap,
    "unchunked.mcap": lambda snapshot, path: write_mcap(snapshot, path, chunked=False, indexed=False),
    "a.bag": write_ros1_bag,
    "unindexed.bag": _bag_without_index,
    "a.db3": _db3,
}


def claims_on_tails(folder: Path) -> list[Claim]:
    """Print the table of rates, and return what is expected of them."""
    rows, claims = [], []
    for name, write in WRITERS.items():
        path = folder / name
        write(make_snapshot(lidars=2, frames=10, points=10_000), path)
        whole_bytes = path.stat().st_size
        rates, hole_bytes = [], 0.0
        for kind, size_mb in TAILS:
            os.truncate(path, whole_bytes)
            _append(path, kind, size_mb)
            command = [sys.executable, "-m", __name__, str(path)]
            ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            taken_s, read_bytes = json.loads(ended.stdout)
            rates.append(size_mb / taken_s)
            hole_bytes = read_bytes if kind == "hole" else hole_bytes
        path.unlink()
        rows.append((name, *(f"{rate:.0f}" for rate in rates), f"{hole_bytes / 1e6:.1f}"))
        rate = f">= {LEAST_MB_S:.0f} MB/s"
        claims.append(Claim(f"slowest end of {name}", rate, f"{min(rates):.0f} MB/s", min(rates) >= LEAST_MB_S))
        holds = hole_bytes <= MOST_READ_OF_HOLE
        expected = f"<= {MOST_READ_OF_HOLE / 1e6:.0f} MB"
        claims.append(Claim(f"bytes read of {name} with a hole", expected, f"{hole_bytes / 1e6:.1f} MB", holds))
    print("Recordings with another end, MB of it per second of processor time:\n")
    print_table(("file", *(f"{kind} {size_mb} MB" for kind, size_mb in TAILS), "MB read, hole"), rows)
    return claims


def _append(path: Path, kind: str, size_mb: int) -> None:
    draw = np.random.default_rng(size_mb)
    with path.open("ab") as file:
        if kind == "hole":
            file.truncate(file.tell() + size_mb * _MB)
        for _ in range(size_mb if kind != "hole" else 0):
            file.write(bytes(_MB) if kind == "zeros" else draw.bytes(_MB))


def _cost(path: Path) -> tuple[float, int]:
    """Processor seconds of the fastest of some readings, which has nothing to import, and the bytes of the last one."""
    from multilica.ingest import read_snapshot

    times_s, read_bytes = [], 0
    for _ in range(REPEATS):
        before_bytes, start_s = _bytes_so_far(), time.process_time()
        read_snapshot(path)
        times_s.append(time.process_time() - start_s)
        read_bytes = _bytes_so_far() - before_bytes
    return min(times_s), read_bytes


def _bytes_so_far() -> int:
    return int(Path("/proc/self/io").read_text(encoding="ascii").split()[1])


if __name__ == "__main__":
    print(json.dumps(_cost(Path(sys.argv[1]))))
