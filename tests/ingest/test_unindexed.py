# SPDX-License-Identifier: Apache-2.0
"""What a recording without an index costs to read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from multilica.ingest import unindexed
from multilica.ingest.chunked import PackedChunk
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.mcap_scan import open_unindexed
from multilica.ingest.recording import Message
from multilica.ingest.unindexed import UnindexedRecording
from tests.ingest.recording_writers import make_snapshot, write_mcap

CHUNK_BYTES = 10_000


class Scan:
    """Ten chunks that hold a message of three bytes each, then damage; counts how often it was run."""

    def __init__(self) -> None:
        self.runs = 0

    def __call__(self) -> Iterator[Message]:
        self.runs += 1
        for time_ns in range(10):
            yield Message("/a", "type", "cdr", time_ns, memoryview(bytes(CHUNK_BYTES))[:3], "A scan")
        raise DamagedRecordingError("a.mcap", "the file ends too early")


@pytest.mark.parametrize(("limit_bytes", "runs"), [(11 * CHUNK_BYTES, 1), (9 * CHUNK_BYTES, 3)])
def test_only_small_recordings_are_kept_in_memory(monkeypatch: pytest.MonkeyPatch, limit_bytes: int, runs: int) -> None:
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", limit_bytes)
    scan = Scan()
    recording = UnindexedRecording("MCAP without index", scan)
    assert recording.damage == "the file ends too early"
    for start_ns in (0, 4):
        found: list[int] = []
        with pytest.raises(DamagedRecordingError, match="ends too early"):
            found.extend(message.log_time_ns for message in recording.messages({"/a"}, start_ns))
        assert found == list(range(start_ns, 10))
    assert scan.runs == runs


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_a_large_recording_without_a_summary_is_not_unpacked_to_learn_what_is_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType, chunked: bool
) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(make_snapshot(frames=40, points=200), path, compression=compression, chunked=chunked, chunk_size=20_000)
    content = path.read_bytes()
    unpacked, unpack = [], PackedChunk.unpack
    monkeypatch.setattr(PackedChunk, "unpack", lambda *args: unpacked.append(args) or unpack(*args))
    for size in range(len(content) * 3 // 10, len(content), len(content) // 37):
        path.write_bytes(content[:size])
        monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", 1 << 40)
        read = open_unindexed(path)
        monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", 0)
        unpacked.clear()
        told = open_unindexed(path)
        # The first, for its channels, and one that was cut off.
        assert len(unpacked) <= 2
        names = {topic.name for topic in read.topics}
        assert (told.topics, told.damage) == (read.topics, read.damage)
        assert told.span_ns(names) == read.span_ns(names)
        assert all_of(told.messages(names)) == all_of(read.messages(names))
        read.close()


def all_of(messages: Iterator[Message]) -> list[tuple[str, int, bytes]]:
    found = []
    with suppress(DamagedRecordingError):
        found.extend((message.topic, message.log_time_ns, bytes(message.data)) for message in messages)
    return found
