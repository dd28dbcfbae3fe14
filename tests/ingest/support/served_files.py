# SPDX-License-Identifier: Apache-2.0
"""Files for servers of every kind, and what reading a window of one may cost."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

from multilica.config import IngestConfig
from multilica.ingest import read_snapshot
from multilica.ingest.remote.file_cache import BLOCK_BYTES
from tests.ingest.support.recording_writers import (
    assert_same_points,
    assert_same_times,
    make_snapshot,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

CHUNK_BYTES = 1 << 20
WINDOW = IngestConfig(frames=3, start_s=9.0)
BUCKET = "fleet-logs"


def write_files(folder: Path) -> Path:
    write_mcap(
        make_snapshot(frames=150, points=4000),
        folder / "long.mcap",
        compression=CompressionType.NONE,
        chunk_size=CHUNK_BYTES,
    )
    write_mcap(make_snapshot(), folder / "unindexed.mcap", indexed=False)
    write_ros1_bag(make_snapshot(), folder / "drive.bag")
    write_ros2_bag(make_snapshot(), folder / "bag")
    metadata = folder / "bag" / "metadata.yaml"
    text = metadata.read_text(encoding="utf-8")
    metadata.write_text(text.replace("custom_data: null", "custom_data: {vehicle: bus 7}"), encoding="utf-8")
    (folder / "notes.txt").write_text("It rained.", encoding="utf-8")
    return folder


def needed_bytes(path: Path) -> int:
    """Index, hashed edges and the chunks of the window, each rounded up to blocks, with a few that are read ahead."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    begin_ns = summary.statistics.message_start_time + 9_000_000_000
    chunks = [
        index
        for index in summary.chunk_indexes
        if index.message_end_time >= begin_ns and index.message_start_time <= begin_ns + 200_000_000
    ]
    largest = max(index.chunk_length for index in summary.chunk_indexes) + 2 * BLOCK_BYTES
    # The first and the last chunk tell when the recording begins and ends.
    return (len(chunks) + 2 + 3) * largest + 2 * (CHUNK_BYTES + BLOCK_BYTES)


def assert_a_window_costs_its_chunks(kind: type, url: str, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`kind`: the class of an open file, in whose `_fetch_range` the bytes arrive."""
    fetched: list[int] = []
    fetch = kind._fetch_range

    def counted(self: object, start: int, end: int) -> bytes:
        data = fetch(self, start, end)
        fetched.append(len(data))
        return data

    monkeypatch.setattr(kind, "_fetch_range", counted)
    assert_equal_to_the_file(url, path, WINDOW)
    assert 0 < sum(fetched) <= needed_bytes(path)


def assert_equal_to_the_file(url: str, path: Path, config: IngestConfig) -> None:
    found, expected = read_snapshot(url, config=config), read_snapshot(path, config=config)
    assert_same_points(found, expected)
    assert_same_times(found, expected)
    assert [len(lidar.scans) for lidar in found.lidars] == [config.frames] * 2
