# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that sends nothing is waited for, yet not to the end of the recording."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from multilica.config import IngestConfig
from multilica.ingest import read_snapshot
from multilica.ingest.containers.chunked import ChunkedRecording
from multilica.ingest.locate import find_source
from multilica.ingest.opening import open_source
from multilica.ingest.recording import Messages
from multilica.ingest.selection.window import TopicFrames, until_full
from multilica.snapshot import Snapshot
from tests.ingest.support.recording_writers import PERIOD_NS, START_NS, make_snapshot, write_mcap, write_ros1_bag

FIVE = IngestConfig(frames=5)


@pytest.mark.parametrize(("name", "write"), [("a.mcap", write_mcap), ("a.bag", write_ros1_bag)])
def test_one_that_falls_silent(tmp_path: Path, name: str, write: Callable[[Snapshot, Path], None]) -> None:
    front, rear = make_snapshot(frames=600).lidars
    write(Snapshot((front, replace(rear, scans=(*rear.scans[:3], *rear.scans[590:])))), tmp_path / name)
    streams = {topic: TopicFrames(topic, 5) for topic in (front.topic, rear.topic)}
    last_ns = 0
    with closing(open_source(find_source(tmp_path / name))) as recording:
        for message in until_full(recording, streams, 0):
            streams[message.topic].take(message)
            last_ns = message.log_time_ns
    assert [stream.fell_silent for stream in streams.values()] == [False, True]
    assert 10.0 < (last_ns - START_NS) / 1e9 < 10.5
    snapshot = read_snapshot(tmp_path / name, config=FIVE)
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [5, 3]
    assert snapshot.notes == (f"'{rear.topic}' fell silent: 3 of 5 scans, then none for 10 s.",)


def test_one_that_comes_back_much_later_has_seen_something_else(tmp_path: Path) -> None:
    front, rear = make_snapshot(frames=200).lidars
    write_mcap(Snapshot((front, replace(rear, scans=rear.scans[150:]))), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap", config=FIVE)
    assert snapshot.names == (front.name,)
    assert snapshot.notes == (f"'{rear.topic}' is left out: no scan for 10 s; a later --start may have it.",)


def test_one_that_starts_later(tmp_path: Path) -> None:
    front, rear = make_snapshot(frames=100).lidars
    write_mcap(Snapshot((front, replace(rear, scans=rear.scans[90:]))), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap", config=FIVE)
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [5, 5]
    assert snapshot.notes == ()


def test_one_that_is_slow(tmp_path: Path) -> None:
    front, rear = make_snapshot(frames=400).lidars
    write_mcap(Snapshot((front, replace(rear, scans=rear.scans[::80]))), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap", config=FIVE)
    assert [scan.stamp_ns - rear.scans[0].stamp_ns for scan in snapshot.lidars[1].scans] == [
        number * 80 * PERIOD_NS for number in range(5)
    ]
    assert snapshot.notes == ()


def test_one_that_is_silent_while_frames_are_spread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    front, rear = make_snapshot(frames=900).lidars
    write_mcap(Snapshot((front, replace(rear, scans=rear.scans[:3]))), tmp_path / "a.mcap", chunk_size=4096)
    read: list[str] = []
    split = ChunkedRecording.messages

    def counted(self: ChunkedRecording, topics: Collection[str], start_ns: int = 0) -> Messages:
        for message in split(self, topics, start_ns):
            read.append(message.topic)
            yield message

    monkeypatch.setattr(ChunkedRecording, "messages", counted)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(frames=3, window_s=90.0))
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [3, 1]
    assert 200 < len(read) < 330
