# SPDX-License-Identifier: Apache-2.0
"""ROS 2 bags in SQLite files."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote

import apsw

from multilica.errors import UnreadableSourceError
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import Message, Messages, Recording, Span, Topic, joint_span, normal_type
from multilica.ingest.whole_pages import WHOLE_PAGES, page_bytes

__all__ = ["open_file"]

Streams: TypeAlias = dict[int, Topic]
"""Topic id of the database -> topic."""
Tallies: TypeAlias = dict[int, tuple[int, int, int]]
"""Topic id of the database -> number of messages, first and last log time."""

# Nothing in a database keeps to the types that its columns were declared with.
_TOPICS = """
    SELECT id, IFNULL(CAST(name AS TEXT), ''), IFNULL(CAST(type AS TEXT), ''),
        IFNULL(CAST(serialization_format AS TEXT), '')
    FROM topics
"""
_TALLIES = """
    SELECT topic_id, COUNT(*), MIN(IFNULL(CAST(timestamp AS INTEGER), 0)), MAX(IFNULL(CAST(timestamp AS INTEGER), 0))
    FROM messages GROUP BY topic_id
"""
_MESSAGES_BY_TIME = """
    SELECT topic_id, IFNULL(CAST(timestamp AS INTEGER), 0), IFNULL(CAST(data AS BLOB), x'') FROM messages
    WHERE topic_id IN (SELECT value FROM json_each(?)) AND timestamp >= ? ORDER BY timestamp, id
"""
_MESSAGES_BY_PLACE = """
    SELECT topic_id, IFNULL(CAST(timestamp AS INTEGER), 0), IFNULL(CAST(data AS BLOB), x'') FROM messages
    WHERE topic_id IN (SELECT value FROM json_each(?)) AND timestamp >= ? ORDER BY id
"""
_EVERY_MESSAGE = """
    SELECT topic_id, IFNULL(CAST(timestamp AS INTEGER), 0), CAST(data AS BLOB) FROM messages ORDER BY id
"""


def open_file(path: Path) -> Recording:
    """Open a bare ``.db3`` file.

    The columns that are read are the same in every version of the format, and a file that was cut off still gives what
    lies before the cut, which `rosbags` refuses.

    Raises:
        DamagedRecordingError: not a single message can be read.
        UnreadableSourceError: a database of something else.
    """
    try:
        _require_bag(path)
        return _open_whole(path)
    except DamagedRecordingError:
        return _open_beginning(path)


class Ros2Sqlite:
    """One storage file of a ROS 2 bag, open.

    Args:
        damage: as of `Recording`.
    """

    format = "ROS 2 bag (sqlite3)"
    is_indexed = True

    def __init__(
        self,
        path: Path,
        database: apsw.Connection,
        streams: Streams,
        tallies: Tallies,
        damage: str = "",
    ) -> None:
        self.damage = damage
        self.topics = tuple(sorted(streams.values(), key=lambda topic: (topic.name, topic.message_type)))
        self._path = path
        self._database = database
        self._streams = streams
        self._spans = _spans(streams, tallies)

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of log times; of writing where the file is damaged."""
        chosen = {key: topic for key, topic in self._streams.items() if topic.name in topics}
        query = _MESSAGES_BY_PLACE if self.damage else _MESSAGES_BY_TIME
        bounds = (json.dumps(list(chosen)), start_ns)
        with damage_named(str(self._path)):
            for key, timestamp, data in self._database.execute(query, bounds):
                topic = chosen[key]
                origin = f"In {self._path}, a scan of '{topic.name}'"
                yield Message(topic.name, topic.message_type, topic.encoding, timestamp, data, origin)

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def _require_bag(path: Path) -> None:
    with _connected(path) as database:
        rows = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        database.close()
    tables = {str(name) for (name,) in rows}
    if not {"topics", "messages"} <= tables:
        raise UnreadableSourceError(
            f"{path} is an SQLite file but no ROS 2 bag: expected the tables messages and topics, "
            f"found {', '.join(sorted(tables)) or 'none'}."
        )


def _open_whole(path: Path) -> Ros2Sqlite:
    with path.open("rb") as file:
        page = page_bytes(file.read(18))
    if path.stat().st_size % page:
        raise DamagedRecordingError(str(path), "the file ends too early")
    with _connected(path) as database:
        tallies = {key: (count, first, last) for key, count, first, last in database.execute(_TALLIES)}
        streams = _streams(database, tallies)
        return Ros2Sqlite(path, database, streams, tallies)


def _open_beginning(path: Path) -> Ros2Sqlite:
    with _connected(path, vfs=WHOLE_PAGES) as database:
        # SQLite refuses a file that is shorter than its header says, unless the schema is under repair.
        database.execute("PRAGMA writable_schema=ON")
        tallies, stop = _readable(path, database)
        damage = stop or "the file ends too early"
        if not tallies:
            raise DamagedRecordingError(str(path), damage)
        return Ros2Sqlite(path, database, _streams(database, tallies), tallies, damage)


def _readable(path: Path, database: apsw.Connection) -> tuple[Tallies, str]:
    """The messages that can be read in the order of writing; what stops it."""
    tallies: Tallies = {}
    try:
        with damage_named(str(path)):
            for key, timestamp, _ in database.execute(_EVERY_MESSAGE):
                count, first, last = tallies.get(key, (0, timestamp, timestamp))
                tallies[key] = count + 1, min(first, timestamp), max(last, timestamp)
    except DamagedRecordingError as error:
        return tallies, error.reason
    return tallies, ""


def _streams(database: apsw.Connection, tallies: Tallies) -> Streams:
    return {
        key: Topic(name, normal_type(message_type), encoding, tallies.get(key, (0, 0, 0))[0])
        for key, name, message_type, encoding in database.execute(_TOPICS)
    }


def _spans(streams: Mapping[int, Topic], tallies: Tallies) -> dict[str, Span]:
    spans: dict[str, Span] = {}
    for key, (_, first, last) in tallies.items():
        if key in streams:
            known = spans.get(streams[key].name, (first, last))
            spans[streams[key].name] = min(first, known[0]), max(last, known[1])
    return spans


@contextmanager
def _connected(path: Path, *, vfs: str | None = None) -> Iterator[apsw.Connection]:
    # A write-ahead log beside the file holds messages, too; without one, nothing may be written beside the file.
    immutable = "" if path.with_name(f"{path.name}-wal").exists() else "&immutable=1"
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    with damage_named(str(path)):
        database = apsw.Connection(f"file:{quote(str(path.resolve()))}?mode=ro{immutable}", flags, vfs)
        try:
            database.execute("PRAGMA trusted_schema=OFF")
            yield database
        except BaseException:
            database.close()
            raise
