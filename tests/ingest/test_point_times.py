# SPDX-License-Identifier: Apache-2.0
"""Times of points, as drivers write them; they are read for odometry only."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.ingest.locate import find_source
from multilica.ingest.message_types import decode_cloud, is_cloud
from multilica.ingest.opening import open_source
from multilica.pointcloud2 import PointCloud2, PointField, decode_points, encode_points
from tests.ingest.support.format_writers import LIVOX_POINT_NS, livox_messages, velodyne_messages, write_raw_mcap
from tests.ingest.support.recording_writers import make_snapshot

_XYZ = tuple(PointField(name, 4 * at, 7) for at, name in enumerate("xyz"))
_SECONDS = np.tile([0.0, 0.025, 0.0999, 0.05], 150)
_NANOSECONDS = np.tile([0, 25_000_000, 99_900_000, 50_000_000], 150)


def _decoded(name, datatype, code, times, *, timed=True):
    table = np.zeros(len(times), [("xyz", "<f4", 3), ("time", code)])
    table["xyz"], table["time"] = 1.0, times
    fields = (*_XYZ, PointField(name, 12, datatype))
    step = table.itemsize
    return decode_points(PointCloud2(fields, len(times), 1, step, step * len(times), table.tobytes()), timed=timed)


@pytest.mark.parametrize(
    ("name", "datatype", "code", "times"),
    [
        ("t", 6, "<u4", _NANOSECONDS),
        ("time", 7, "<f4", _SECONDS),
        ("time", 7, "<f4", _SECONDS - 0.0999),
        ("timestamp", 8, "<f8", 1.7e9 + _SECONDS),
        ("timestamp", 8, "<f8", 1.7e18 + _NANOSECONDS),
        ("time_stamp", 6, "<u4", 4_000_000_000 + _NANOSECONDS),
        ("timestamp", 8, "<f8", (1.7e9 + _SECONDS) * 1e6),
        ("offset_time", 6, "<u4", _NANOSECONDS // 1000),
        ("time", 7, "<f4", _SECONDS * 1e3),
        ("time", 7, "<f4", _SECONDS * 1e6),
        ("timestamp", 6, "<u4", 1_700_000_000 + _NANOSECONDS // 1000),
    ],
)
def test_times_begin_with_the_earliest_point(name, datatype, code, times):
    found = _decoded(name, datatype, code, times).times_ns
    np.testing.assert_allclose(found, _NANOSECONDS, atol=2_000)
    assert _decoded(name, datatype, code, times, timed=False).times_ns is None


@pytest.mark.parametrize(
    "times",
    [
        np.array([0.0, np.nan]),
        np.array([0.0, 2e9]),
        np.zeros(2),
        np.array([0.0, 1.2]),
        np.array([0.0, 1e5]),
        np.tile([0.0, 5e5], 300),
        np.tile([0.0, 1_300.0], 300),
        np.array([0.0, 1.0]) * 1e-9,
    ],
    ids=["NaN", "too long", "none", "1.2 s", "a packet", "half a second or millisecond", "no unit", "a nanosecond"],
)
def test_times_that_are_none_of_a_frame_are_left_out(times):
    found = _decoded("timestamp", 8, "<f8", times)
    assert found.times_ns is None
    assert len(found.points_m) == len(times)


@pytest.mark.parametrize("seconds", [1e3, 1e6, 1e9, 1.0])
def test_lost_beams_have_no_time_since_the_epoch(seconds):
    found = _decoded(
        "timestamp", 8, "<f8", (1.7e9 + np.append(_SECONDS, 0.0)) * seconds * np.append(_SECONDS >= 0.0, 0.0)
    ).times_ns
    np.testing.assert_allclose(found, [*_NANOSECONDS, 0], atol=2_000)
    whole = _decoded("t", 6, "<u4", [3_000_000_000, 0, 3_090_000_000, 0]).times_ns
    np.testing.assert_array_equal(whole, [0, 0, 90_000_000, 0])


def test_a_float_that_is_too_coarse_tells_no_time():
    coarse = _decoded("time", 7, "<f4", 1.7e9 + np.array([0.0, 0.05, 0.1, 128.0]))
    assert coarse.times_ns is None


def test_points_without_times_have_none():
    assert decode_points(encode_points(np.ones((3, 3), np.float32)), timed=True).times_ns is None


def test_times_of_livox_are_read_if_wanted(tmp_path: Path):
    path = tmp_path / "livox.mcap"
    write_raw_mcap(livox_messages(make_snapshot(1), "livox_ros_driver2", "cdr"), path, "cdr")
    recording = open_source(find_source(path))
    message = next(recording.messages({topic.name for topic in recording.topics}))
    assert decode_cloud(message).scan.times_ns is None
    timed = decode_cloud(replace(message, timed=True)).scan
    np.testing.assert_array_equal(timed.times_ns, LIVOX_POINT_NS * np.arange(len(timed.points_m)))
    recording.close()


def _first_cloud(path: Path):
    with closing(open_source(find_source([path]))) as recording:
        topics = [topic.name for topic in recording.topics if is_cloud(topic)]
        with closing(recording.messages(topics)) as messages:
            message = next(messages)
    assert decode_cloud(message).scan.times_ns is None
    return decode_cloud(replace(message, timed=True)).scan


def test_packets_of_velodyne_have_times(tmp_path: Path) -> None:
    write_raw_mcap(velodyne_messages("cdr"), tmp_path / "a.mcap", "cdr")
    scan = _first_cloud(tmp_path / "a.mcap")
    # The 75 packets are 1.33 ms apart, and the lasers 2.3 us.
    assert (len(scan.times_ns), scan.times_ns.min()) == (len(scan.points_m), 0)
    np.testing.assert_allclose(scan.times_ns[:16], 2304 * np.arange(16), atol=100)
    np.testing.assert_allclose(scan.times_ns[::384], 1_330_000 * np.arange(75), atol=100)


def test_packets_of_ouster_have_times(tmp_path: Path) -> None:
    pytest.importorskip("ouster.sdk.core", reason="pip install --no-deps 'ouster-sdk>=1.0'")
    from tests.ingest.support.ouster_writers import frame_of, ouster_messages, sensor

    info = sensor()
    frame = frame_of(info, 0)
    write_raw_mcap(ouster_messages(info, [frame]), tmp_path / "a.mcap", "cdr")
    columns = np.nonzero(frame.field("RANGE") > 0)[1]
    expected_ns = frame.timestamp[columns] - frame.timestamp[columns].min()
    np.testing.assert_array_equal(_first_cloud(tmp_path / "a.mcap").times_ns, expected_ns)
