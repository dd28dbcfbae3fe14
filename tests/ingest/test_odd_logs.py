# SPDX-License-Identifier: Apache-2.0
"""Logs that are odd, yet plausible: each is read, or refused in one sentence."""

from __future__ import annotations

import sqlite3
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from multilica.config import IngestConfig
from multilica.errors import MultilicaError, UnfitSnapshotError, UnreadableSourceError
from multilica.ingest import frames_recorded, inspect_source, read_snapshot
from multilica.pointcloud2 import SNAPSHOT_METADATA_NAME
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Snapshot
from tests.ingest.support.recording_writers import (
    CLOUD,
    START_NS,
    TRANSFORMS,
    make_snapshot,
    raw_messages,
    ros2_types,
    transform_message,
)

STRING = "std_msgs/msg/String"
ODOMETRY = "nav_msgs/msg/Odometry"
TEXT = b"\0\1\0\0\6\0\0\0hello\0"


def write_channels(path: Path, messages: list[tuple[str, str, int, bytes]]) -> None:
    """A channel per topic and type, several of which may share a topic."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[tuple[str, str], int] = {}
        for topic, message_type, log_time, data in messages:
            if (topic, message_type) not in channels:
                schema = writer.register_schema(message_type, "", b"")
                channels[topic, message_type] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic, message_type], log_time, data, log_time)
        writer.finish()


def scans() -> list[tuple[str, str, int, bytes]]:
    return list(raw_messages(make_snapshot(), ros2_types(), "cdr"))


@pytest.mark.parametrize("other", [STRING, ODOMETRY, CLOUD, ""])
def test_static_transforms_beside_another_type(tmp_path: Path, other: str) -> None:
    store = ros2_types()
    pose = transform_message(store, [("base", "lidar_1", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])])
    static = ("/tf_static", TRANSFORMS, START_NS, bytes(store.serialize_cdr(pose, TRANSFORMS)))
    write_channels(tmp_path / "a.mcap", [("/tf_static", other, START_NS, TEXT), static, *scans()])
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert [(each.target, each.source) for each in snapshot.static_transforms] == [("base", "lidar_1")]
    assert not any("tf_static" in note and "left out" in note for note in snapshot.notes if other != CLOUD)
    assert inspect_source(tmp_path / "a.mcap").static_transforms


@pytest.mark.parametrize("message_type", [ODOMETRY, "sensor_msgs/msg/Imu", CLOUD])
def test_a_topic_of_two_types(tmp_path: Path, message_type: str) -> None:
    odd = [("/both", kind, START_NS + index, TEXT) for index, kind in enumerate([message_type, STRING] * 20)]
    write_channels(tmp_path / "a.mcap", sorted([*odd, *scans()], key=lambda each: each[2]))
    for config in (IngestConfig(), IngestConfig(window="auto")):
        with suppress(UnfitSnapshotError) if config.window == "auto" else nullcontext():
            assert len(read_snapshot(tmp_path / "a.mcap", config=config).lidars) == 2
    inspect_source(tmp_path / "a.mcap")


@pytest.mark.parametrize("topic", ["", "/", "//", " ", "\u202e", "\x1b[31m"])
def test_a_topic_and_a_frame_without_a_name(tmp_path: Path, topic: str) -> None:
    snapshot = make_snapshot()
    nameless = LidarScans("x", snapshot.lidars[0].scans, "/", topic)
    messages = list(raw_messages(Snapshot((nameless,)), ros2_types(), "cdr"))
    write_channels(tmp_path / "a.mcap", [*messages, *scans()])
    found = read_snapshot(tmp_path / "a.mcap")
    assert len(found.lidars) == 3
    assert all(name and name.isprintable() for name in found.names)
    assert len(inspect_source(tmp_path / "a.mcap").clouds) == 3


@pytest.mark.parametrize(
    ("key", "text"),
    [("frames", "9" * 5000), ("frames", "-1"), ("frames", "1e9"), ("frames", "\u00b2"), ("frames", "99999999"),
     ("notes", "[" * 5000), ("notes", "9" * 5000), ("notes", "[1, null, {}]"), ("notes", "Infinity")],
)  # fmt: skip
def test_metadata_of_no_sense_is_no_metadata(tmp_path: Path, key: str, text: str) -> None:
    whole = {"frames": "3", "notes": "[]"} | {key: text}
    write_snapshot_mcap(make_snapshot(), tmp_path / "a.mcap", metadata=whole)
    assert SNAPSHOT_METADATA_NAME.encode() in (tmp_path / "a.mcap").read_bytes()
    assert frames_recorded([tmp_path / "a.mcap"]) == (3 if key == "notes" else None)
    assert len(read_snapshot(tmp_path / "a.mcap").lidars) == 2


@pytest.mark.parametrize("odd", ["x'0102'", "'one'", "NULL", "2.5", "9223372036854775807", "-1"])
def test_ids_of_a_database_that_are_no_numbers(tmp_path: Path, odd: str) -> None:
    database = sqlite3.connect(tmp_path / "a.db3")
    database.executescript(
        f"""CREATE TABLE topics(id, name TEXT, type TEXT, serialization_format TEXT);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);
        INSERT INTO topics VALUES({odd}, '/odd', '{CLOUD}', 'cdr'), (1, '/lidar_0/points', '{CLOUD}', 'cdr');
        INSERT INTO messages VALUES(1, {odd}, {odd}, x'00'), (2, {odd}, 1, {odd}), (3, {odd}, NULL, NULL);"""
    )
    for _, _, log_time, data in scans()[:2]:
        database.execute("INSERT INTO messages VALUES(NULL, 1, ?, ?)", (log_time, data))
    database.commit()
    database.close()
    assert "lidar_0" in read_snapshot(tmp_path / "a.db3").names
    inspect_source(tmp_path / "a.db3")


@pytest.mark.parametrize("shape", ["(True, 3)", "(3, True)", "(-1, 3)", "(2.0, 3)", "(10**5000, 3)", "(1 << 70, 3)",
                                   "('3', 3)", "(None, 3)", "3", "[2, 3]", "((2,), 3)", "(2,) * 70"])  # fmt: skip
def test_shapes_of_arrays_that_are_none(tmp_path: Path, shape: str) -> None:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".encode()
    path = tmp_path / "a.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(24))
    with pytest.raises(UnreadableSourceError, match=r"a\.npy "):
        read_snapshot(path)


ODD_HEADERS = {
    "COUNT": ["1 1 0", "0 0 0", "1 1 -1", "1 1 99999999999", "1 1", "1 1 1 1", "1 1 x", f"1 1 {'9' * 5000}"],
    "SIZE": ["4 4 0", "4 4 3", "4 4 99999999999", "4 4", "4 4 4.0", "0 0 0", "\u0664 4 4"],
    "TYPE": ["F F", "F F X", "F F F F", "f f f"],
    "WIDTH": ["-1", "1e3", "9" * 5000, "", "\u00b2"],
    "HEIGHT": ["0", "-1", "9" * 18],
    "POINTS": ["9", "x", ""],
    "FIELDS": ["x y", "x x x", "_ _ _", "x y z " * 2000],
}


@pytest.mark.parametrize("storage", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize(("key", "text"), [(key, text) for key, texts in ODD_HEADERS.items() for text in texts])
def test_headers_of_pcd_files_that_are_odd(tmp_path: Path, storage: str, key: str, text: str) -> None:
    entries = {"FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": "2", "HEIGHT": "1",
               "POINTS": "2"} | {key: text}  # fmt: skip
    head = "".join(f"{name} {value}\n" for name, value in entries.items())
    bodies = {
        "ascii": b"1 2 3\n4 5 6\n",
        "binary": np.arange(6, dtype="<f4").tobytes(),
        "binary_compressed": bytes(64),
    }
    path = tmp_path / "a.pcd"
    path.write_bytes(f"VERSION 0.7\n{head}DATA {storage}\n".encode() + bodies[storage])
    refusal = ""
    try:
        assert read_snapshot(path).lidars[0].points_count <= 2
    except MultilicaError as error:
        refusal = str(error)
    assert not refusal or ("a.pcd" in refusal and len(refusal) <= 500)


@pytest.mark.parametrize("suffix", ["mcap", "db3", "bag", "pcd", "ply", "las", "bin", "npy", "mcap.zst", "dat"])
def test_a_pointer_of_git_lfs_is_told_as_one(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    for read in (read_snapshot, inspect_source):
        with pytest.raises(UnreadableSourceError, match=r"is a pointer of Git LFS, not the file; .*`git lfs pull`"):
            read(path)
