# SPDX-License-Identifier: Apache-2.0
"""Packets of Ouster give the points that its own library makes of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError
from multilica.ingest import inspect_source, read_snapshot
from tests.ingest.support.format_writers import write_raw_mcap
from tests.ingest.support.recording_writers import PERIOD_NS, START_NS

pytest.importorskip("ouster.sdk.core", reason="pip install --no-deps 'ouster-sdk>=1.0'")

from tests.ingest.support.ouster_writers import (
    PROFILES,
    expected_points_m,
    frame_of,
    ouster_messages,
    sensor,
    wire,
)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize("profile", PROFILES)
def test_turns_have_the_points_of_the_library(tmp_path: Path, profile: str, encoding: str) -> None:
    info = sensor(profile)
    frames = [frame_of(info, number) for number in range(3)]
    write_raw_mcap(ouster_messages(info, frames, encoding), tmp_path / "a.mcap", encoding)
    (cloud,) = inspect_source(tmp_path / "a.mcap").clouds
    assert cloud.rate_hz == pytest.approx(10.0, rel=0.02)
    (lidar,) = read_snapshot(tmp_path / "a.mcap").lidars
    assert (lidar.name, lidar.topic, len(lidar.scans)) == ("os_lidar", "/ouster/lidar_packets", 3)
    for number, (scan, frame) in enumerate(zip(lidar.scans, frames, strict=True)):
        np.testing.assert_allclose(scan.points_m, expected_points_m(info, frame), atol=1e-5)
        assert scan.stamp_ns == START_NS + number * PERIOD_NS
        assert scan.intensity is not None
        np.testing.assert_array_equal(scan.intensity, frame.field("SIGNAL")[frame.field("RANGE") > 0])


def test_reading_may_begin_within_a_turn(tmp_path: Path) -> None:
    info = sensor()
    write_raw_mcap(ouster_messages(info, [frame_of(info, number) for number in range(5)]), tmp_path / "a.mcap", "cdr")
    config = IngestConfig(frames=2, start_s=0.12)
    (lidar,) = read_snapshot(tmp_path / "a.mcap", config=config).lidars
    assert [scan.stamp_ns for scan in lidar.scans] == [START_NS + number * PERIOD_NS for number in (2, 3)]


def test_lost_late_and_repeated_packets(tmp_path: Path) -> None:
    info = sensor()
    frames = [frame_of(info, number) for number in range(3)]
    messages = list(ouster_messages(info, frames))
    packets = [index for index, message in enumerate(messages) if message[0].endswith("lidar_packets")]
    # The second turn has lost its third packet; its fifth comes once more, after the first of the third turn.
    late = (*messages[packets[68]][:2], messages[packets[128]][2] + 1, messages[packets[68]][3])
    kept = [message for index, message in enumerate(messages) if index != packets[66]]
    write_raw_mcap(iter(sorted([*kept, late], key=lambda message: message[2])), tmp_path / "a.mcap", "cdr")
    (lidar,) = read_snapshot(tmp_path / "a.mcap").lidars
    counts = [len(scan.points_m) for scan in lidar.scans]
    whole = len(expected_points_m(info, frames[0]))
    assert counts[0] == counts[2] == whole
    assert 0 < whole - counts[1] <= 16 * 64


def test_what_inspect_says(tmp_path: Path) -> None:
    info = sensor()
    write_raw_mcap(ouster_messages(info, [frame_of(info, number) for number in range(4)]), tmp_path / "a.mcap", "cdr")
    summary = inspect_source(tmp_path / "a.mcap")
    (cloud,) = summary.clouds
    assert (cloud.topic, cloud.frames) == ("/ouster/lidar_packets", 4)
    assert {topic.name for topic in summary.others} == {"/ouster/metadata", "/ouster/imu_packets"}
    assert not [note for note in summary.notes if "packets" in note]


def test_two_sensors_are_told_apart_by_their_topics(tmp_path: Path) -> None:
    info = sensor()
    frames = [frame_of(info, number) for number in range(2)]
    both = [*ouster_messages(info, frames, namespace="/front"), *ouster_messages(info, frames, namespace="/rear")]
    write_raw_mcap(iter(sorted(both, key=lambda message: message[2])), tmp_path / "a.mcap", "cdr")
    assert read_snapshot(tmp_path / "a.mcap").names == ("front/lidar_packets", "rear/lidar_packets")


def _impossible(columns: int) -> bytes:
    table = json.loads(sensor().to_json_string())
    table["lidar_data_format"]["columns_per_frame"] = columns
    return json.dumps(table).encode()


@pytest.mark.parametrize("metadata", [None, b"", b"{}", b"\xff", _impossible(1 << 28), _impossible(0)])
def test_packets_without_usable_metadata_are_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], metadata: bytes | None
) -> None:
    info = sensor()
    head, *packets = ouster_messages(info, [frame_of(info, 0)])
    beside = [] if metadata is None else [(*head[:3], wire(metadata, "cdr"))]
    write_raw_mcap(iter([*beside, *packets]), tmp_path / "a.mcap", "cdr")
    with pytest.raises(UnfitSnapshotError, match=r"holds? packets of Ouster without the topic 'metadata'"):
        read_snapshot(tmp_path / "a.mcap")
    assert capfd.readouterr() == ("", "")
