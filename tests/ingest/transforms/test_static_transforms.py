# SPDX-License-Identifier: Apache-2.0
"""`/tf_static` in whatever state it is."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from rosbags import rosbag1

from multilica.ingest import inspect_source
from multilica.ingest.locate import find_source
from multilica.ingest.opening import open_source
from multilica.ingest.transforms import read_static_transforms
from tests.ingest.support.recording_writers import START_NS, TRANSFORMS, ros1_types, ros2_types, transform_message

HALF = math.sqrt(0.5)
Entry = tuple[str, str, list[float], list[float]]


def write_transforms(path: Path, *messages: list[Entry], topic: str = "/tf_static", period_ns: int = 0) -> None:
    store = ros2_types()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(TRANSFORMS, "ros2msg", b"")
        channel = writer.register_channel(topic, "cdr", schema)
        for number, entries in enumerate(messages):
            data = (
                bytes(store.serialize_cdr(transform_message(store, entries), TRANSFORMS)) if entries else b"\0\1\0\0\5"
            )
            time_ns = START_NS + number * period_ns
            writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()


def test_the_last_word_counts_and_the_broken_are_left_out(tmp_path: Path) -> None:
    good = ("base", "roof", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])
    moved = ("/base", "/roof", [4.0, 5.0, 6.0], [0.0, 0.0, HALF, HALF * 1.001])
    broken: list[Entry] = [
        ("base", "zero", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]),
        ("base", "huge", [0.0, 0.0, 0.0], [1e300, 1e300, 0.0, 0.0]),
        ("base", "nan", [0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 1.0]),
        ("base", "far", [math.inf, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ("base", "base", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ("", "orphan", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
    ]
    write_transforms(tmp_path / "a.mcap", [good, *broken], [], [moved])
    summary = inspect_source(tmp_path / "a.mcap")
    (pose,) = summary.static_transforms
    assert (pose.target, pose.source) == ("base", "roof")
    np.testing.assert_allclose(pose.xyz_m, [4.0, 5.0, 6.0])
    np.testing.assert_allclose(pose.rpy_deg, [0.0, 0.0, 90.0], atol=0.1)
    assert len(summary.notes) == len(broken) + 1
    for word in ("'zero'", "'huge'", "'nan'", "'far'", "two different names", "cannot be unpacked"):
        assert any(word in note for note in summary.notes), word


def test_what_is_repeated_for_hours_is_not_read_for_hours(tmp_path: Path) -> None:
    roof = ("base", "roof", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])
    late, never = (("base", name, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]) for name in ("late", "never"))
    write_transforms(tmp_path / "a.mcap", *[[roof]] * 8, [late], *[[roof]] * 200, [never], period_ns=10**9)
    read: list[int] = []
    with closing(open_source(find_source(tmp_path / "a.mcap"))) as recording:
        messages = recording.messages
        recording.messages = lambda topics: (
            read.append(message.log_time_ns) or message for message in messages(topics)
        )
        transforms, notes = read_static_transforms(recording)
    assert [transform.source for transform in transforms] == ["late", "roof"]
    assert notes == ()
    assert len(read) == 9 + 10
    write_transforms(tmp_path / "b.mcap", *[[roof]] * 100, [late], period_ns=10**7)
    assert len(inspect_source(tmp_path / "b.mcap").static_transforms) == 2


def test_moving_transforms_are_no_static_ones(tmp_path: Path) -> None:
    write_transforms(tmp_path / "a.mcap", [("map", "base", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])], topic="/tf")
    assert inspect_source(tmp_path / "a.mcap").static_transforms == ()


def write_tf_of_ros1(path: Path, messages: dict[int, list[Entry]], topic: str = "/tf") -> Path:
    """Log time before the stamp of the transforms in ns -> transforms."""
    store = ros1_types()
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection(topic, TRANSFORMS, typestore=store)
        for ahead_ns, entries in messages.items():
            data = bytes(store.serialize_ros1(transform_message(store, entries), TRANSFORMS))
            writer.write(connection, START_NS - ahead_ns, data)
    return path


def test_what_a_static_publisher_of_ros1_repeats_counts(tmp_path: Path) -> None:
    level = [0.0, 0.0, 0.0, 1.0]
    roof, mast = ("base", "roof", [1.0, 2.0, 3.0], level), ("base", "mast", [0.0, 0.0, 1.0], level)
    moves = [("odom", "base", [float(x_m), 0.0, 0.0], level) for x_m in range(3)]
    once = ("base", "once", [0.0, 1.0, 0.0], level)
    ahead_ns = (3 * 10**8, 2 * 10**8, 10**8)
    ahead = {time_ns: [roof, pose] for time_ns, pose in zip(ahead_ns, moves, strict=True)}
    ahead[2 * 10**8].append(once)
    path = write_tf_of_ros1(tmp_path / "a.bag", {**ahead, -(10**8): [mast], -(2 * 10**8): [mast]})
    (pose,) = inspect_source(path).static_transforms
    assert (pose.target, pose.source) == ("base", "roof")
    np.testing.assert_allclose(pose.xyz_m, [1.0, 2.0, 3.0])


def test_what_is_repeated_on_tf_is_not_read_for_long(tmp_path: Path) -> None:
    roof = ("base", "roof", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])
    messages = {number * 10**7: [roof] for number in range(2000, 0, -1)}
    read: list[int] = []
    with closing(open_source(find_source(write_tf_of_ros1(tmp_path / "a.bag", messages)))) as recording:
        messages_of = recording.messages
        recording.messages = lambda topics: (
            read.append(message.log_time_ns) or message for message in messages_of(topics)
        )
        (pose,), _ = read_static_transforms(recording)
        assert (pose.source, len(read)) == ("roof", 256)
        recording.is_indexed = False
        assert read_static_transforms(recording) == ((), ())


def test_a_frame_with_two_parents_is_told(tmp_path: Path) -> None:
    level = [0.0, 0.0, 0.0, 1.0]
    write_transforms(
        tmp_path / "a.mcap", [("base", "roof", [1.0, 0.0, 0.0], level)], [("nose", "roof", [9.0, 0, 0], level)]
    )
    (note,) = inspect_source(tmp_path / "a.mcap").notes
    assert note == "'/tf_static' gives 'roof' the parents base, nose; expected one: remove the others."
