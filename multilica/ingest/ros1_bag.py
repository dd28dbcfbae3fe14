# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from rosbags.rosbag1 import Reader

from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import Message, Recording, Span, Topic, joint_span
from multilica.ingest.ros1_scan import open_unindexed

__all__ = ["open_file"]


def open_file(path: Path) -> Recording:
    """Open a ``.bag`` file: by its index, or from front to end where that is missing.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    reader = Reader(path)
    try:
        with damage_named(str(path)):
            reader.open()
    except DamagedRecordingError:
        return open_unindexed(path)
    return IndexedRos1Bag(path, reader)


class IndexedRos1Bag:
    """A bag whose index is whole."""

    format = "ROS 1 bag"
    damage = ""

    def __init__(self, path: Path, reader: Reader) -> None:
        self._path = path
        self._reader = reader
        self._spans: dict[str, Span] = {}
        for name, info in reader.topics.items():
            times = [entry.time for link in info.connections for entry in reader.indexes.get(link.id, ())]
            if times:
                self._spans[name] = min(times), max(times)
        self.topics = tuple(
            Topic(name, info.msgtype or "several types", "ros1", info.msgcount)
            for name, info in sorted(reader.topics.items())
        )

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known from the index."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Iterator[Message]:
        """In the order of log times."""
        chosen = [link for link in self._reader.connections if link.topic in topics]
        if not chosen:
            return
        with damage_named(str(self._path)):
            for link, log_time_ns, data in self._reader.messages(chosen, start=start_ns):
                # A damaged index may point to a message of another connection.
                if link.topic in topics:
                    origin = f"In {self._path}, a scan of '{link.topic}'"
                    yield Message(link.topic, link.msgtype, "ros1", log_time_ns, data, origin)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
