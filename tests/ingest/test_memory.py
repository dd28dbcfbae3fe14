# SPDX-License-Identifier: Apache-2.0
"""Small files that ask for much memory or time, each read in a process that has little of both."""

from __future__ import annotations

import gc
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from multilica.config import IngestConfig
from multilica.errors import MultilicaError
from multilica.ingest import read_snapshot
from multilica.ingest.locate import find_source
from multilica.ingest.memory import MemoryBudget, MemoryLimitError, limited_memory, memory_budget
from multilica.ingest.opening import open_source
from tests.ingest.support.confined import read_confined
from tests.ingest.support.format_writers import write_raw_mcap
from tests.ingest.support.mutations import write_seed
from tests.ingest.support.recording_writers import CLOUD, START_NS, make_snapshot, write_mcap, write_ros1_bag
from tests.selection import NIGHTLY, some_of

TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
TOPIC = "INSERT INTO topics VALUES(1, '/a', 'sensor_msgs/msg/PointCloud2', 'cdr');"
PLAIN = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
GENERATED = PLAIN.replace("data BLOB", "data BLOB GENERATED ALWAYS AS (zeroblob(900000000))")
ENDLESS = """CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)
    SELECT x AS id, 1 AS topic_id, x AS timestamp, zeroblob(1000) AS data FROM c;"""
SCHEMAS = {
    "computed column 'data'": f"{TOPICS}{GENERATED}{TOPIC}INSERT INTO messages VALUES(1, 1, 1), (2, 1, 2);",
    "view 'messages'": f"{TOPICS}{ENDLESS}{TOPIC}",
    "trigger 't'": f"{TOPICS}{PLAIN}CREATE TRIGGER t AFTER INSERT ON topics BEGIN DELETE FROM messages; END;",  # noqa: S608
    "index 'i' with an expression": f"{TOPICS}{PLAIN}CREATE INDEX i ON messages(length(data));",
    "index 'p' with an expression": f"{TOPICS}{PLAIN}CREATE INDEX p ON messages(id) WHERE timestamp > 5;",
    "virtual table 'v'": f"{TOPICS}{PLAIN}CREATE VIRTUAL TABLE v USING fts5(x);",
}


def write_database(path: Path, script: str) -> None:
    database = sqlite3.connect(path)
    database.executescript(script)
    database.close()


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("what", some_of(SCHEMAS, 2))
def test_no_sql_of_a_file_is_run(tmp_path: Path, what: str) -> None:
    write_database(tmp_path / "bomb.db3", SCHEMAS[what])
    warm_up = write_seed("plain.db3", tmp_path)
    snapshot, summary, taken_s = read_confined(tmp_path / "bomb.db3", warm_up)
    for text in (snapshot, summary):
        assert f"it defines the {what}, which a ROS 2 bag does not have" in text
    assert taken_s < 5.0


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_page_that_is_linked_many_times_ends(tmp_path: Path) -> None:
    """Interior pages whose cells all point to the next level: a small file with more rows than atoms."""
    path = tmp_path / "bomb.db3"
    write_database(path, f"PRAGMA page_size = 4096;{TOPICS}{PLAIN}{TOPIC}")
    with sqlite3.connect(path) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    content = bytearray(path.read_bytes())
    first, levels, cells = len(content) // 4096 + 1, 5, 300
    pages = [_interior(first + level, cells) for level in range(levels)]
    # Payload of five bytes, row 1: no id of its own, topic 1, time 1, no data.
    leaf_cells = bytes([5, 1, 5, 0, 9, 9, 0])
    leaf = bytearray(4096)
    leaf[:8] = struct.pack(">BHHHB", 13, 0, 1, 4096 - len(leaf_cells), 0)
    leaf[8:10] = struct.pack(">H", 4096 - len(leaf_cells))
    leaf[4096 - len(leaf_cells) :] = leaf_cells
    content[(root - 1) * 4096 : root * 4096] = pages[0]
    content += b"".join(pages[1:]) + leaf
    content[28:32] = struct.pack(">I", len(content) // 4096)
    path.write_bytes(content)
    snapshot, _, taken_s = read_confined(path, write_seed("plain.db3", tmp_path))
    assert "REFUSED" in snapshot
    assert taken_s < 12.0


def _interior(child: int, cells: int) -> bytes:
    page = bytearray(4096)
    start = 4096 - 5 * cells
    page[:12] = struct.pack(">BHHHBI", 5, 0, cells, start, 0, child)
    for index in range(cells):
        place = start + 5 * index
        page[12 + 2 * index : 14 + 2 * index] = struct.pack(">H", place)
        page[place : place + 5] = struct.pack(">IB", child, 1)
    return bytes(page)


def _zstd_bomb(path: Path, *, tiny: bool) -> None:
    """Truthful chunks of the same time that shrink a thousandfold: large messages, or very many; at night more."""
    count = (400_000 if NIGHTLY else 150_000) if tiny else 60 if NIGHTLY else 15
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=60_000_000)
        writer.start()
        schema = writer.register_schema(CLOUD, "ros2msg", b"")
        channel = writer.register_channel("/a", "cdr", schema)
        for index in range(count):
            writer.add_message(channel, START_NS + index % 7, bytes(10 if tiny else 50_000_000), START_NS)
        writer.finish()


def _sparse(head: bytes, size: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.write(head)
            file.truncate(size)

    return write


def _pcd(storage: str, points: int) -> bytes:
    return f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {points}\nHEIGHT 1\nDATA {storage}\n".encode()


def _ply(storage: str, points: int) -> bytes:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return f"ply\nformat {storage} 1.0\nelement vertex {points}\n{axes}end_header\n".encode()


def _cloud_of_overlapping_fields(path: Path) -> None:
    fields = b"".join(
        struct.pack("<I", 2) + axis + b"\0" + b"\0\0" + struct.pack("<IB3xI", 0, 1, 1) for axis in (b"x", b"y", b"z")
    )
    size = 60_000_000
    body = b"\0\1\0\0" + struct.pack("<iII", 0, 0, 1) + b"\0" + bytes(3)
    body += struct.pack("<III", 1, size, 3) + fields + struct.pack("<B3xIII", 0, 1, size, size) + bytes(size)
    write_raw_mcap(iter([("/a", CLOUD, START_NS, body)]), path, "cdr")


GB = 1 << 30
BOMBS: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "large.mcap": ("zstd.mcap", lambda path: _zstd_bomb(path, tiny=False), ""),
    "tiny.mcap": ("zstd.mcap", lambda path: _zstd_bomb(path, tiny=True), ""),
    "overlap.mcap": ("zstd.mcap", _cloud_of_overlapping_fields, ""),
    "one.pcd": ("binary.pcd", _sparse(_pcd("binary", 1), GB), "READ"),
    "text.pcd": ("ascii.pcd", _sparse(_pcd("ascii", 1), GB), "a line has more than 65536 bytes"),
    "many.pcd": ("binary.pcd", _sparse(_pcd("binary", GB // 12 - 10), GB), "MemoryLimitError"),
    "lines.pcd": ("ascii.pcd", _sparse(_pcd("ascii", 10**9) + b"1 2 3\n", GB), "MemoryLimitError"),
    "one.ply": ("binary.ply", _sparse(_ply("binary_little_endian", 1), GB), "READ"),
    "many.ply": ("binary.ply", _sparse(_ply("binary_little_endian", 10**17), GB), "MemoryLimitError"),
    "full.bin": ("a.bin", _sparse(b"", GB), "MemoryLimitError"),
    "many.las": ("a.las", _sparse(b"LASF", GB), "MemoryLimitError"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", some_of(BOMBS, 2))
def test_a_bomb_is_read_or_refused_within_bounds(tmp_path: Path, name: str) -> None:
    seed, write, expected = BOMBS[name]
    write(tmp_path / name)
    (tmp_path / "seed").mkdir()
    snapshot, summary, taken_s = read_confined(tmp_path / name, write_seed(seed, tmp_path / "seed"))
    assert expected in snapshot
    assert "bug" not in snapshot + summary
    assert taken_s < 20.0


def test_what_is_needed_decides_over_the_limit(tmp_path: Path) -> None:
    write_mcap(make_snapshot(points=20_000), tmp_path / "a.mcap")
    assert read_snapshot(tmp_path / "a.mcap", config=IngestConfig(max_memory_mb=50)).lidars
    with pytest.raises(
        MemoryLimitError, match=r"a\.mcap takes more than 1 MB of memory .* raise ingest\.max_memory_mb"
    ):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(max_memory_mb=1))


@pytest.mark.slow
def test_released_memory_counts_no_more() -> None:
    budget = MemoryBudget(1.0)
    for _ in range(5):
        view = budget.empty(600_000)
        assert budget.taken_bytes == 600_000
        part = view[10:]
        del view
        assert budget.taken_bytes == 600_000
        del part
        gc.collect()
        assert budget.taken_bytes == 0
    kept = budget.keep(bytes(900_000))
    with pytest.raises(MemoryLimitError):
        budget.empty(200_000)
    assert len(kept) == 900_000


def test_each_ingest_has_a_budget_of_its_own() -> None:
    with limited_memory(5.0, "a.mcap") as outer:
        assert memory_budget() is outer
        with limited_memory(1.0, "b.mcap") as inner:
            assert memory_budget() is inner
        assert memory_budget() is outer
    with (
        pytest.raises(MemoryLimitError, match=r"Reading a\.mcap takes more memory than this machine"),
        limited_memory(1.0, "a.mcap"),
    ):
        np.empty(1 << 60, np.uint8)


def test_messages_that_nobody_waits_for_take_none(tmp_path: Path) -> None:
    """A reader that stops early leaves the rest of a chunk."""
    write_mcap(make_snapshot(frames=5), tmp_path / "a.mcap", chunk_size=1 << 20)
    with limited_memory(5.0, "a.mcap") as budget, closing(open_source(find_source(tmp_path / "a.mcap"))) as recording:
        before = budget.taken_bytes
        for _ in range(20):
            with closing(recording.messages([topic.name for topic in recording.topics])) as messages:
                next(messages)
        assert budget.taken_bytes == before


HOLE_BYTES = 8 << 30
BAG_LINE_BYTES = len(b"#ROSBAG V2.0\n")


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(
    "name", some_of(["unindexed.mcap", "unchunked.mcap", "zstd.mcap", "plain.bag", "plain.db3"], 2)
)
def test_zeros_behind_a_recording_cost_nothing(tmp_path: Path, name: str) -> None:
    """As a power loss leaves them: blocks that were set aside and never written."""
    (tmp_path / "seed").mkdir()
    seed = write_seed(name, tmp_path / "seed")
    content = seed.read_bytes()
    path = tmp_path / name
    path.write_bytes(content[: len(content) * 3 // 4])
    with path.open("r+b") as file:
        file.truncate(HOLE_BYTES)
    snapshot, _, taken_s = read_confined(path, seed)
    assert taken_s < 8.0
    assert "bug" not in snapshot


@pytest.mark.slow
@pytest.mark.in_turn
def test_zeros_that_are_stored_are_skipped_fast(tmp_path: Path) -> None:
    """At 200 MB/s or more, before and behind further records."""
    (tmp_path / "seed").mkdir()
    seed = write_seed("unchunked.mcap", tmp_path / "seed")
    content = seed.read_bytes()
    with (tmp_path / "a.mcap").open("wb") as file:
        file.write(content[:-40])
        for _ in range(200):
            file.write(bytes(1_000_000))
    snapshot, _, taken_s = read_confined(tmp_path / "a.mcap", seed)
    assert snapshot.startswith("READ")
    assert "the file ends in zeros, as after a power loss" in snapshot
    # Opened twice, and each time surveyed and read.
    assert taken_s < 4 * 1.0 + 1.0


def test_records_behind_a_region_of_zeros_are_read(tmp_path: Path) -> None:
    snapshot = make_snapshot(lidars=1, frames=4)
    write_mcap(snapshot, tmp_path / "a.mcap", chunked=False, indexed=False)
    content = (tmp_path / "a.mcap").read_bytes()
    second = content.index(b"\x05", content.index(b"lidar_0", content.index(b"lidar_0") + 400) - 80)
    for at in (second, len(content) - 40):
        path = tmp_path / "b.mcap"
        path.write_bytes(content[:at] + bytes(10_000) + content[at:])
        assert len(read_snapshot(path).lidars[0].scans) >= 1


def test_records_of_a_bag_behind_zeros_are_read(tmp_path: Path) -> None:
    whole = make_snapshot(lidars=2, frames=4)
    path = tmp_path / "a.bag"
    write_ros1_bag(whole, path)
    content = path.read_bytes()
    first = BAG_LINE_BYTES
    for _ in ("header", "data"):
        first += 4 + int.from_bytes(content[first : first + 4], "little")
    path.write_bytes(content[:first] + bytes(10_000) + content[first:])
    assert [len(lidar.scans) for lidar in read_snapshot(path).lidars] == [4, 4]
    path.write_bytes(content[:first] + bytes(10_000))
    with pytest.raises(MultilicaError, match="the file ends in zeros, as after a power loss"):
        read_snapshot(path)
