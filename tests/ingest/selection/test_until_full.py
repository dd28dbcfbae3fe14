# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that sends nothing is waited for, yet not to the end of the recording."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError
from multilica.ingest import inspect_source, read_snapshot, require_calibratable
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
    left_out = f"'{rear.topic}' is left out: its scans begin 15.0 s after the window begins; --start 15 has all."
    assert snapshot.notes == (left_out,)
    later = read_snapshot(tmp_path / "a.mcap", config=FIVE.model_copy(update={"start_s": 15.0}))
    assert [len(lidar.scans) for lidar in later.lidars] == [5, 5]


def test_one_that_pauses_may_be_in_a_later_window(tmp_path: Path) -> None:
    front, rear = make_snapshot(frames=300).lidars
    write_mcap(Snapshot((front, replace(rear, scans=(*rear.scans[:5], *rear.scans[290:])))), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap", config=FIVE.model_copy(update={"start_s": 5.0}))
    assert snapshot.notes == (f"'{rear.topic}' is left out: no scan for 10 s; a later --start may have it.",)


def test_one_that_ended_before_the_window(tmp_path: Path) -> None:
    rear, front = make_snapshot(frames=100).lidars
    write_mcap(Snapshot((replace(front, scans=front.scans[20:]), replace(rear, scans=rear.scans[:50]))), tmp_path / "a")
    late = IngestConfig(frames=5, start_s=8.0)
    ended = f"'{rear.topic}' is left out: its scans end 3.1 s before the window begins; --start 2 has all."
    assert read_snapshot(tmp_path / "a", config=late).notes == (ended,)
    assert read_snapshot(tmp_path / "a", config=late.model_copy(update={"window_s": 1.0})).notes == (ended,)
    found = read_snapshot(tmp_path / "a", config=IngestConfig(frames=5, start_s=2.0))
    assert [len(lidar.scans) for lidar in found.lidars] == [5, 5]


@pytest.mark.parametrize(
    ("offset_s", "told"),
    [
        (100, "begin 85.1 s after those of the others. If all were recorded at once, its clock is 100.0 s ahead: set"),
        (-100, "begin 85.1 s after those of the others. If all were recorded at once, its clock is 100.0 s ahead: set"),
        (86_400 * 365, "begin 365 days after those of the others. If all were recorded at once, its clock is 365 days"),
    ],
)
def test_recorders_whose_clocks_differ(tmp_path: Path, offset_s: int, told: str) -> None:
    front, rear = make_snapshot(frames=150).lidars
    for lidar, shift_ns in ((front, 0), (rear, offset_s * 10**9)):
        scans = tuple(replace(scan, stamp_ns=scan.stamp_ns + shift_ns) for scan in lidar.scans)
        write_mcap(Snapshot((replace(lidar, scans=scans),)), tmp_path / f"{lidar.name}.mcap")
    paths = [tmp_path / f"{lidar.name}.mcap" for lidar in (front, rear)]
    snapshot = read_snapshot(paths, config=FIVE)
    (left_out,) = [lidar for lidar in (front, rear) if lidar.name not in snapshot.names]
    (note,) = snapshot.notes
    assert note.startswith(f"'{left_out.topic}' is left out: its scans {told}")
    assert "shift the times of its recording; else record all LiDARs at once." in note
    with pytest.raises(UnfitSnapshotError) as refused:
        require_calibratable(snapshot)
    assert str(refused.value).endswith(f"calibration needs at least two. {note}")
    assert inspect_source(paths).objection.endswith("calibration needs at least two.")


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
