# SPDX-License-Identifier: Apache-2.0
"""What reading ten frames from the middle of a recording takes, measured in a process of its own."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from multilica.config import IngestConfig
from multilica.ingest import inspect_source, snapshot_reader
from multilica.snapshot import Snapshot

FRAMES = 10

Value = TypeVar("Value")


def main(path: Path) -> None:
    """Print the figures as JSON: bytes that were asked of the system, seconds, memory."""
    middle_s = (inspect_source(path, config=IngestConfig(frames=1)).duration_s or 0.0) / 2.0
    hash_bytes, hash_s, digest = _cost(lambda: snapshot_reader.sha256_of_files([path]))
    snapshot_reader.sha256_of_files = lambda _: digest
    before_bytes = _resident_bytes()
    config = IngestConfig(frames=FRAMES, start_s=middle_s)
    read_bytes, read_s, snapshot = _cost(lambda: snapshot_reader.read_snapshot(path, config=config))
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    print(
        json.dumps(
            {
                "hash_bytes": hash_bytes,
                "hash_s": hash_s,
                "read_bytes": read_bytes,
                "read_s": read_s,
                "frames_bytes": 26 * _points(snapshot),
                "points_bytes": 16 * _points(snapshot),
                "peak_bytes": peak_bytes,
                "grown_bytes": peak_bytes - before_bytes,
            }
        )
    )


def _cost(run: Callable[[], Value]) -> tuple[int, float, Value]:
    bytes_before, start_s = _read_bytes(), time.perf_counter()
    value = run()
    return _read_bytes() - bytes_before, time.perf_counter() - start_s, value


def _points(snapshot: Snapshot) -> int:
    return sum(lidar.points_count for lidar in snapshot.lidars)


def _read_bytes() -> int:
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("rchar")))


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
