# SPDX-License-Identifier: Apache-2.0
"""What a recording without an index costs to read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from operator import itemgetter
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from multilica.config import IngestConfig
from multilica.ingest import read_snapshot
from multilica.ingest.containers import mcap_file, ros1_bag, unindexed
from multilica.ingest.containers.chunked import PackedChunk
from multilica.ingest.containers.mcap_file import open_unindexed
from multilica.ingest.containers.unindexed import Part, UnindexedRecording
from multilica.ingest.recording import DamagedRecordingError, RawMessage
from multilica.snapshot import Snapshot
from tests.ingest.support.recording_writers import (
    PERIOD_NS,
    START_NS,
    make_snapshot,
    raw_messages,
    ros2_types,
    write_mcap,
    write_ros1_bag,
)

CHUNK_BYTES = 10_000


class Scan:
    """Ten chunks that hold two messages of three bytes each, then half a one; counts the chunks that it unpacks."""

    def __init__(self) -> None:
        self.unpacked = 0

    def __call__(self, place: int) -> Iterator[Part]:
        for number in range(place, 11):
            yield number + 1, self._messages(number)

    def _messages(self, number: int) -> Iterator[RawMessage]:
        self.unpacked += 1
        chunk = memoryview(bytes(CHUNK_BYTES))
        for half in range(2):
            if (number, half) == (10, 1):
                raise DamagedRecordingError("a.mcap", "the file ends too early")
            yield RawMessage("/a", "type", "cdr", 2 * number + half, chunk[:3], "A scan")


@pytest.mark.parametrize(
    ("limit_bytes", "unpacked"),
    [(12 * CHUNK_BYTES, 11), (11 * CHUNK_BYTES, 33), (0, 33)],
)
def test_what_is_kept_is_not_unpacked_again(monkeypatch: pytest.MonkeyPatch, limit_bytes: int, unpacked: int) -> None:
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", limit_bytes)
    scan = Scan()
    recording = UnindexedRecording("MCAP without index", "a.mcap", scan)
    assert recording.damage == "the file ends too early"
    for start_ns in (0, 7):
        found: list[int] = []
        with pytest.raises(DamagedRecordingError, match="ends too early"):
            found.extend(message.log_time_ns for message in recording.messages({"/a"}, start_ns))
        assert found == list(range(start_ns, 21))
    assert scan.unpacked == unpacked


@pytest.mark.parametrize("make", ["mcap", "unchunked mcap", "bag"])
@pytest.mark.parametrize("cut", [1.0, 0.9])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_recording_too_large_to_keep_is_read_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: str, cut: float, share: float
) -> None:
    path = tmp_path / "a"
    snapshot = make_snapshot(frames=40, points=200)
    if make == "bag":
        write_ros1_bag(snapshot, path)
    else:
        write_mcap(snapshot, path, indexed=False, chunked=make == "mcap", chunk_size=20_000)
    os.truncate(path, int(cut * path.stat().st_size))
    open_file = ros1_bag.open_unindexed if make == "bag" else mcap_file.open_unindexed
    whole = open_file(path, "a")
    names = {topic.name for topic in whole.topics}
    expected = all_of(whole.messages(names))
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", int(share * sum(len(data) + 256 for *_, data in expected)))
    part = open_file(path, "a")
    assert (part.topics, part.damage) == (whole.topics, whole.damage)
    assert all_of(part.messages(names)) == expected
    assert all_of(part.messages(names)) == expected


@pytest.mark.parametrize("kept_bytes", [0, 1 << 40])
@pytest.mark.parametrize("cut", [1.0, 0.9])
@pytest.mark.parametrize("window_s", [0.0, 2.0])
def test_topics_that_were_written_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept_bytes: int, cut: float, window_s: float
) -> None:
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", kept_bytes)
    path = tmp_path / "a.mcap"
    messages = [*raw_messages(make_snapshot(lidars=3, frames=150), ros2_types(), "cdr")]
    write_mcap(Snapshot(()), path, chunked=False, messages=sorted(messages, key=itemgetter(0)))
    os.truncate(path, int(cut * path.stat().st_size))
    snapshot = read_snapshot(path, config=IngestConfig(window_s=window_s))
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [10, 10, 10]
    names = {lidar.topic for lidar in snapshot.lidars}
    times = [log_time_ns for _, log_time_ns, _ in all_of(open_unindexed(path, "a").messages(names))]
    assert times == sorted(times)
    assert (len(times) == 450) == (cut == 1.0)


def test_a_clock_that_was_set_back_keeps_the_order_of_writing(tmp_path: Path) -> None:
    messages = [*raw_messages(make_snapshot(frames=60), ros2_types(), "cdr")]
    moved = [(topic, kind, time - 10**10, data) for topic, kind, time, data in messages[60:]]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", chunked=False, messages=[*messages[:60], *moved])
    recording = open_unindexed(tmp_path / "a.mcap", "a")
    found = [time for _, time, _ in all_of(recording.messages({topic.name for topic in recording.topics}))]
    assert found == [time for _, _, time, _ in [*messages[:60], *moved]]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("has_chunks", [True, False])
def test_the_survey_does_not_unpack_a_large_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType, has_chunks: bool
) -> None:
    path = tmp_path / "a.mcap"
    snapshot = make_snapshot(frames=40, points=200)
    write_mcap(snapshot, path, compression=compression, chunked=has_chunks, chunk_size=20_000)
    content = path.read_bytes()
    unpacked, unpack = [], PackedChunk.unpack
    monkeypatch.setattr(PackedChunk, "unpack", lambda *args: unpacked.append(args) or unpack(*args))
    for size in range(len(content) * 3 // 10, len(content), len(content) // 37):
        path.write_bytes(content[:size])
        monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", 1 << 40)
        read = open_unindexed(path, "a")
        monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", 0)
        unpacked.clear()
        told = open_unindexed(path, "a")
        # The first, for its channels, and one that was cut off.
        assert len(unpacked) <= 2
        names = {topic.name for topic in read.topics}
        assert (told.topics, told.damage) == (read.topics, read.damage)
        assert told.span_ns(names) == read.span_ns(names)
        assert all_of(told.messages(names)) == all_of(read.messages(names))
        read.close()


@pytest.mark.parametrize("make", ["survey", "no survey", "bag"])
def test_what_lies_before_the_window_is_not_unpacked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: str
) -> None:
    path = tmp_path / "a"
    if make == "bag":
        write_ros1_bag(make_snapshot(frames=40, points=2000), path)
    else:
        write_mcap(make_snapshot(frames=40, points=200), path, indexed=make == "survey", chunk_size=20_000)
    os.truncate(path, int(0.9 * path.stat().st_size))
    monkeypatch.setattr(unindexed, "_MARK_BYTES", 1)
    open_file = ros1_bag.open_unindexed if make == "bag" else mcap_file.open_unindexed
    whole = open_file(path, "a")
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", 0)
    recording = open_file(path, "a")
    unpacked, unpack = [], PackedChunk.unpack
    monkeypatch.setattr(PackedChunk, "unpack", lambda *args: unpacked.append(args) or unpack(*args))
    names = {topic.name for topic in whole.topics}
    counts = []
    for frame in (0, 7, 20, 33):
        unpacked.clear()
        start_ns = START_NS + frame * PERIOD_NS
        assert all_of(recording.messages(names, start_ns)) == all_of(whole.messages(names, start_ns))
        counts.append(len(unpacked))
    assert counts == sorted(counts, reverse=True)
    assert 1 <= counts[-1] <= max(1, counts[0] // 3)


def all_of(messages: Iterator[RawMessage]) -> list[tuple[str, int, bytes]]:
    found = []
    with suppress(DamagedRecordingError):
        found.extend((message.topic, message.log_time_ns, bytes(message.data)) for message in messages)
    return found
