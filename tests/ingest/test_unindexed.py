# SPDX-License-Identifier: Apache-2.0
"""What a recording without an index costs to read."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from multilica.ingest import unindexed
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message
from multilica.ingest.unindexed import UnindexedRecording

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
