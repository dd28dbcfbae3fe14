# SPDX-License-Identifier: Apache-2.0
"""`/tf_static` in whatever state it is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from multilica.ingest import inspect_source
from tests.ingest.recording_writers import START_NS, TRANSFORMS, ros2_types, transform_message

HALF = math.sqrt(0.5)
Entry = tuple[str, str, list[float], list[float]]


def write_transforms(path: Path, *messages: list[Entry], topic: str = "/tf_static") -> None:
    store = ros2_types()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(TRANSFORMS, "ros2msg", b"")
        channel = writer.register_channel(topic, "cdr", schema)
        for entries in messages:
            data = (
                bytes(store.serialize_cdr(transform_message(store, entries), TRANSFORMS)) if entries else b"\0\1\0\0\5"
            )
            writer.add_message(channel, START_NS, data, START_NS)
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


def test_moving_transforms_are_no_static_ones(tmp_path: Path) -> None:
    write_transforms(tmp_path / "a.mcap", [("map", "base", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])], topic="/tf")
    assert inspect_source(tmp_path / "a.mcap").static_transforms == ()
