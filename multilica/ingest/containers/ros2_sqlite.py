# SPDX-License-Identifier: Apache-2.0
"""The reader of ROS 2 bags in SQLite files.

`rosbags` refuses a file that was cut off; this reader returns the messages before the cut.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote

import apsw

from multilica.errors import UnreadableSourceError
from multilica.ingest.decompression import MAX_UNPACKED_BYTES
from multilica.ingest.memory import memory_budget
from multilica.ingest.recording import (
    DamagedRecordingError,
    Messages,
    Recording,
    Span,
    Topic,
    damage_named,
    joint_span,
    joint_topics,
    normal_type,
)

Tallies: TypeAlias = Mapping[int, tuple[int, int, int]]
"""Topic id of the database -> number of messages, first and last log time in nanoseconds."""

_WHOLE_PAGES = "multilica_whole_pages"
_HEADER_BYTES = 18

# Values in a database need not have the types of their columns.
_TIME = "IFNULL(CAST(timestamp AS INTEGER), 0)"
_TOPICS = """
    SELECT id, IFNULL(CAST(name AS TEXT), ''), IFNULL(CAST(type AS TEXT), ''),
        IFNULL(CAST(serialization_format AS TEXT), '')
    FROM topics WHERE typeof(id) = 'integer'
"""
_TALLIES = f"""
    SELECT topic_id, COUNT(*), MIN({_TIME}), MAX({_TIME}) FROM messages
    WHERE typeof(topic_id) = 'integer' GROUP BY topic_id
"""  # noqa: S608
_MESSAGES = f"""
    SELECT topic_id, {_TIME}, IFNULL(CAST(data AS BLOB), x'') FROM messages
    WHERE topic_id IN (SELECT value FROM json_each(?)) AND timestamp >= ? ORDER BY
"""  # noqa: S608
_EVERY_MESSAGE = f"""
    SELECT topic_id, {_TIME}, CAST(data AS BLOB) FROM messages WHERE typeof(topic_id) = 'integer' ORDER BY id
"""  # noqa: S608
_TABLES = ("topics", "messages")
_STEPS_PER_BYTE = 20
_FREE_STEPS = 5_000_000
"""A row has five bytes or more and takes up to a hundred steps of SQLite's machine; a page that is linked many times
would take them without end."""
_STEPS_PER_CALL = 1_000_000
_MAX_SQL_BYTES = 1 << 20


def open_file(path: Path, where: str) -> Recording:
    """Open a ``.db3`` file; raise UnreadableSourceError if it is a database of something else."""
    try:
        return _open_whole(path, where)
    except DamagedRecordingError:
        return _open_beginning(path, where)


class Ros2Sqlite(Recording):
    """One open storage file of a ROS 2 bag, with `topics` by their ids in the database."""

    format = "ROS 2 bag (sqlite3)"

    def __init__(
        self, where: str, database: apsw.Connection, topics: Mapping[int, Topic], tallies: Tallies, damage: str = ""
    ) -> None:
        self.damage = damage
        self.topics = joint_topics((topic, tallies.get(key, (0, 0, 0))[0]) for key, topic in topics.items())
        self._where = where
        self._database = database
        self._topics = topics
        self._tallies = tallies

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span, which is known since the file was opened."""
        chosen = (key for key, topic in self._topics.items() if topic.name in topics and key in self._tallies)
        return joint_span(self._tallies[key][1:] for key in chosen)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time; in the order of writing if the file is damaged."""
        chosen = {key: topic for key, topic in self._topics.items() if topic.name in topics}
        query = _MESSAGES + ("id" if self.damage else "timestamp, id")
        with damage_named(self._where):
            memory = memory_budget()
            for key, log_time_ns, data in self._database.execute(query, (json.dumps(list(chosen)), start_ns)):
                memory.require(len(data))
                yield chosen[key].message(log_time_ns, data, self._where)

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def _open_whole(path: Path, where: str) -> Ros2Sqlite:
    with _connected(path, where) as database:
        tables = _require_plain(database)
        if not {*_TABLES} <= tables:
            raise UnreadableSourceError(
                f"{where} is an SQLite file but not a ROS 2 bag: expected the tables messages and topics, "
                f"found {', '.join(sorted(tables)) or 'none'}."
            )
        with path.open("rb") as file:
            page = _page_bytes(file.read(_HEADER_BYTES))
        if path.stat().st_size % page:
            raise DamagedRecordingError(where, "the file ends too early")
        tallies = {key: (count, first, last) for key, count, first, last in database.execute(_TALLIES)}
        return Ros2Sqlite(where, database, _topics(database), tallies)


def _open_beginning(path: Path, where: str) -> Ros2Sqlite:
    with _connected(path, where, vfs=_WHOLE_PAGES) as database:
        # SQLite refuses a file that is shorter than its header says, unless the schema is under repair.
        database.execute("PRAGMA writable_schema=ON")
        _require_plain(database)
        tallies: dict[int, tuple[int, int, int]] = {}
        damage = "the file ends too early"
        try:
            with damage_named(where):
                for key, time_ns, _ in database.execute(_EVERY_MESSAGE):
                    count, first, last = tallies.get(key, (0, time_ns, time_ns))
                    tallies[key] = count + 1, min(first, time_ns), max(last, time_ns)
        except DamagedRecordingError as error:
            damage = error.reason
        if not tallies:
            raise DamagedRecordingError(where, damage)
        return Ros2Sqlite(where, database, _topics(database), tallies, damage)


def _require_plain(database: apsw.Connection) -> set[str]:
    """Return the names of the tables; raise ValueError if the schema has anything that SQLite would execute."""
    tables: set[str] = set()
    for kind, name, table, root_page in database.execute(
        "SELECT type, name, tbl_name, rootpage FROM sqlite_master"
    ).fetchall():
        is_virtual = kind == "table" and not root_page
        if kind not in ("table", "index") or is_virtual:
            what = "virtual table" if is_virtual else str(kind)
            raise ValueError(f"it defines the {what} '{name}', which a ROS 2 bag does not have")
        if kind == "table":
            tables.add(str(name))
        elif table in _TABLES:
            # The number -2 stands for a column of the index that is none of the table's.
            columns = database.execute("SELECT cid FROM pragma_index_xinfo(?)", (name,)).fetchall()
            partial = database.execute("SELECT name FROM pragma_index_list(?) WHERE partial", (table,)).fetchall()
            if (-2,) in columns or (name,) in partial:
                raise ValueError(f"it defines the index '{name}' with an expression, which a ROS 2 bag does not have")
    for table in tables & {*_TABLES}:
        rows = database.execute("SELECT name FROM pragma_table_xinfo(?) WHERE hidden <> 0", (table,)).fetchall()
        if rows:
            raise ValueError(f"it defines the computed column '{rows[0][0]}', which a ROS 2 bag does not have")
    return tables


def _limit(database: apsw.Connection, file_bytes: int) -> None:
    """Bound what a query may take: no value is longer than the file, no query has more steps than its rows need."""
    database.execute("PRAGMA trusted_schema=OFF")
    database.execute("PRAGMA cell_size_check=ON")
    database.limit(apsw.SQLITE_LIMIT_LENGTH, min(MAX_UNPACKED_BYTES, file_bytes + _MAX_SQL_BYTES))
    database.limit(apsw.SQLITE_LIMIT_SQL_LENGTH, _MAX_SQL_BYTES)
    database.limit(apsw.SQLITE_LIMIT_COLUMN, 200)
    database.limit(apsw.SQLITE_LIMIT_ATTACHED, 0)
    calls_left = 1 + (_FREE_STEPS + _STEPS_PER_BYTE * file_bytes) // _STEPS_PER_CALL

    def is_over() -> bool:
        nonlocal calls_left
        calls_left -= 1
        return calls_left < 0

    database.set_progress_handler(is_over, _STEPS_PER_CALL)


def _topics(database: apsw.Connection) -> dict[int, Topic]:
    return {
        key: Topic(name, normal_type(message_type), encoding)
        for key, name, message_type, encoding in database.execute(_TOPICS)
    }


@contextmanager
def _connected(path: Path, where: str, *, vfs: str | None = None) -> Iterator[apsw.Connection]:
    # A write-ahead log beside the file holds messages, too; without one, nothing may be written beside the file.
    immutable = "" if path.with_name(f"{path.name}-wal").exists() else "&immutable=1"
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    with damage_named(where):
        database = apsw.Connection(f"file:{quote(str(path.resolve()))}?mode=ro{immutable}", flags, vfs)
        try:
            _limit(database, path.stat().st_size)
            yield database
        except BaseException:
            database.close()
            raise


def _page_bytes(header: bytes) -> int:
    """Return the page size in bytes from the beginning of an SQLite file; 1 if it states none."""
    size = int.from_bytes(header[_HEADER_BYTES - 2 : _HEADER_BYTES], "big")
    # In two bytes, 65536 is written as 1.
    return 65536 if size == 1 else max(size, 1)


class _WholePages(apsw.VFS):
    """A file system that ends each file with its last whole page.

    SQLite fills a page that was cut off with zeros, which would become points.
    """

    def xOpen(self, name: str | apsw.URIFilename | None, flags: list[int]) -> apsw.VFSFile:  # noqa: N802
        """Open a file for SQLite."""
        return _WholePagesFile("", name, flags)


class _WholePagesFile(apsw.VFSFile):
    def xFileSize(self) -> int:  # noqa: N802
        """Return the size for SQLite."""
        size = super().xFileSize()
        return size - size % _page_bytes(super().xRead(_HEADER_BYTES, 0)) if size >= _HEADER_BYTES else 0


_REGISTERED = _WholePages(_WHOLE_PAGES, "")
