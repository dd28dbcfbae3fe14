# SPDX-License-Identifier: Apache-2.0
"""The same scene in the formats of every make gives the same points."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import foxglove.messages as fox
import numpy as np
import pytest

from multilica.errors import MultilicaError, UnfitSnapshotError, UnreadableSourceError
from multilica.ingest import message_types, opening, read_snapshot
from multilica.ingest.message_types import decode_cloud
from multilica.ingest.recording import RawMessage
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.format_writers import (
    LIVOX_DRIVERS,
    POINT_WRITERS,
    foxglove_cloud,
    json_cloud,
    livox_messages,
    velodyne_messages,
    write_foxglove_json,
    write_foxglove_sdk,
    write_mcap_ros1,
    write_raw_mcap,
)
from tests.ingest.support.recording_writers import (
    START_NS,
    assert_same_points,
    assert_same_times,
    make_snapshot,
    raw_messages,
    ros2_types,
)

NODE_MODULES = Path(__file__).parents[2] / "node" / "node_modules"


@pytest.fixture(scope="module")
def scene() -> Snapshot:
    """On a grid of a millimetre, intensities from 0 to 255: what every format can hold."""
    return Snapshot(
        tuple(
            LidarScans(
                lidar.name,
                tuple(
                    Scan(np.round(scan.points_m, 3), scan.stamp_ns, np.round(scan.intensity)) for scan in lidar.scans
                ),
                topic=lidar.topic,
            )
            for lidar in make_snapshot().lidars
        )
    )


def _livox(driver: str, encoding: str) -> Callable[[Snapshot, Path], None]:
    return lambda scene, path: write_raw_mcap(livox_messages(scene, driver, encoding), path, encoding)


RECORDINGS: dict[str, Callable[[Snapshot, Path], None]] = {
    "foxglove-sdk": write_foxglove_sdk,
    "foxglove-json": write_foxglove_json,
    "mcap_ros1": write_mcap_ros1,
    **{f"{driver}-{encoding}": _livox(driver, encoding) for driver in LIVOX_DRIVERS for encoding in ("ros1", "cdr")},
}
del RECORDINGS["livox_ros_driver-cdr"]  # no such driver


@pytest.mark.parametrize("make", RECORDINGS)
def test_recordings_of_other_makes(tmp_path: Path, scene: Snapshot, make: str) -> None:
    RECORDINGS[make](scene, tmp_path / "a.mcap")
    found = read_snapshot(tmp_path / "a.mcap")
    assert found.notes == ()
    assert_same_points(found, scene)
    assert_same_times(found, scene)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.skipif(not NODE_MODULES.is_dir(), reason="run: npm install --prefix tests/node --no-package-lock")
def test_a_file_written_by_mcap_core(tmp_path: Path, scene: Snapshot) -> None:
    lines = [
        json.dumps({"topic": topic, "type": kind, "logTime": str(time_ns), "data": base64.b64encode(data).decode()})
        for topic, kind, time_ns, data in raw_messages(scene, ros2_types(), "cdr")
    ]
    command = ["node", str(Path(__file__).parent / "write_mcap.cjs"), str(tmp_path / "a.mcap")]
    environment = {**os.environ, "NODE_PATH": str(NODE_MODULES)}
    subprocess.run(command, input="\n".join(lines), text=True, check=True, env=environment, timeout=60)
    found = read_snapshot(tmp_path / "a.mcap")
    assert found.notes == ()
    assert_same_points(found, scene)
    assert_same_times(found, scene)


@pytest.mark.parametrize("name", POINT_WRITERS)
def test_point_files_of_other_makes(tmp_path: Path, scene: Snapshot, name: str) -> None:
    scan = scene.lidars[0].scans[0]
    POINT_WRITERS[name](scan, tmp_path / name)
    (found,) = read_snapshot(tmp_path / name).lidars[0].scans
    np.testing.assert_allclose(found.points_m, scan.points_m, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(found.intensity, scan.intensity)


@pytest.mark.parametrize("order", ["C", "F"])
def test_numpy_arrays_of_every_kind(tmp_path: Path, order: str) -> None:
    points = np.arange(1.0, 31.0).reshape(10, 3)
    records = np.zeros(10, [("t", "<u8"), ("z", ">f8"), ("y", "<i2"), ("x", "<f4")])
    records["x"], records["y"], records["z"] = points.T
    for array in (np.asarray(points, order=order), points.astype(">f4"), points.astype(np.int16), records):
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(read_snapshot(tmp_path / "a.npy").lidars[0].scans[0].points_m, points)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_velodyne_packets(tmp_path: Path, encoding: str) -> None:
    write_raw_mcap(velodyne_messages(encoding, range_m=10.0), tmp_path / "a.mcap", encoding)
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert snapshot.names == ("velodyne",)
    (scan,) = snapshot["velodyne"].scans
    assert len(scan.points_m) > 20_000
    np.testing.assert_allclose(np.linalg.norm(scan.points_m, axis=1), 10.0, atol=0.1)
    assert scan.stamp_ns == 1700 * 10**9


@pytest.mark.parametrize("range_m", [0.05, 131.0, 260.0])
def test_no_range_of_velodyne_is_dropped(tmp_path: Path, range_m: float) -> None:
    write_raw_mcap(velodyne_messages("cdr", range_m, model=0x28), tmp_path / "a.mcap", "cdr")
    (scan,) = read_snapshot(tmp_path / "a.mcap")["velodyne"].scans
    assert len(scan.points_m) > 20_000


def test_an_unknown_model_of_velodyne_is_named(tmp_path: Path) -> None:
    beside = [*velodyne_messages("cdr", model=77), *livox_messages(make_snapshot(), "livox_ros_driver2", "cdr")]
    write_raw_mcap(iter(sorted(beside, key=lambda message: message[2])), tmp_path / "a.mcap", "cdr")
    (note, *_) = read_snapshot(tmp_path / "a.mcap").notes
    assert "cannot be decoded (Data from an unsupported Velodyne model, Model ID in packet: 77); replay the log" in note
    assert note.endswith("through the driver velodyne_pointcloud.")


def test_packets_name_the_driver_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (message_types, opening):
        monkeypatch.setattr(module, "is_installed", lambda requires: not requires)
    write_raw_mcap(velodyne_messages("cdr"), tmp_path / "a.mcap", "cdr")
    with pytest.raises(
        UnfitSnapshotError, match=r"packets of Velodyne; `pip install 'multilica\[velodyne\]'`, or replay"
    ):
        read_snapshot(tmp_path / "a.mcap")
    ouster = [("/ouster/lidar_packets", "ouster_sensor_msgs/msg/PacketMsg", START_NS, b"\0" * 40)]
    write_raw_mcap(iter(ouster), tmp_path / "b.mcap", "cdr")
    with pytest.raises(UnfitSnapshotError, match=r"'/ouster/lidar_packets' holds packets of Ouster; .* ouster_ros"):
        read_snapshot(tmp_path / "b.mcap")
    beside = [*ouster, *livox_messages(make_snapshot(), "livox_ros_driver2", "cdr")]
    write_raw_mcap(iter(beside), tmp_path / "c.mcap", "cdr")
    (note,) = read_snapshot(tmp_path / "c.mcap").notes
    assert "packets of Ouster" in note


def _velodyne_beside(topic: str, path: Path) -> Snapshot:
    """Packets on /velodyne_packets and on /pandar_packets beside the cloud of a Livox on a topic."""
    lidar = make_snapshot(lidars=1).lidars[0]
    cloud = Snapshot((LidarScans("cloud", lidar.scans, topic=topic),))
    hesai = [("/pandar_packets", "hesai_ros_driver/msg/UdpFrame", START_NS, b"\0" * 40)]
    messages = [*velodyne_messages("cdr", range_m=10.0), *hesai, *livox_messages(cloud, "livox_ros_driver2", "cdr")]
    write_raw_mcap(iter(messages), path, "cdr")
    return read_snapshot(path)


def test_packets_beside_the_clouds_made_of_them_are_left_out(tmp_path: Path) -> None:
    found = _velodyne_beside("/velodyne_points", tmp_path / "a.mcap")
    assert [lidar.topic for lidar in found.lidars] == ["/velodyne_points"]
    assert [note.partition(", which")[0] for note in found.notes] == [
        "'/pandar_packets' holds packets of Hesai",
        "'/velodyne_packets' holds packets of LiDARs whose clouds are recorded, too, and are used.",
    ]


def test_packets_beside_clouds_of_other_lidars_are_read(tmp_path: Path) -> None:
    found = _velodyne_beside("/livox_points", tmp_path / "a.mcap")
    assert [lidar.topic for lidar in found.lidars] == ["/livox_points", "/velodyne_packets"]


@pytest.mark.parametrize(
    ("packets", "clouds", "is_twin"),
    [
        ("/top/velodyne_packets", "/top/pointcloud_raw_ex", True),
        ("/ouster/lidar_packets", "/ouster/points", True),
        ("/velodyne_packets", "/velodyne_points", True),
        ("/packets", "/points", True),
        ("/lidar/velodyne_packets", "/lidar/rslidar_points", False),
        ("/velodyne_packets", "/points", False),
        ("/top/packets", "/rear/points", False),
    ],
)
def test_what_makes_packets_those_of_a_cloud(packets: str, clouds: str, *, is_twin: bool, tmp_path: Path) -> None:
    (_, kind, time_ns, data), *_ = velodyne_messages("cdr")
    cloud = Snapshot((LidarScans("cloud", make_snapshot(lidars=1).lidars[0].scans, topic=clouds),))
    messages = [(packets, kind, time_ns, data), *livox_messages(cloud, "livox_ros_driver2", "cdr")]
    write_raw_mcap(iter(messages), tmp_path / "a.mcap", "cdr")
    assert len(read_snapshot(tmp_path / "a.mcap").lidars) == (1 if is_twin else 2)


def test_a_pose_of_the_cloud_in_its_frame_is_told(tmp_path: Path, scene: Snapshot) -> None:
    scan = scene.lidars[0].scans[0]
    pose = fox.Pose(position=fox.Vector3(x=1.0, y=0.0, z=2.0), orientation=fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
    data = foxglove_cloud(scan, "base_link", pose).encode()
    write_raw_mcap(iter([("/a", "foxglove.PointCloud", START_NS, data)]), tmp_path / "a.mcap", "protobuf")
    snapshot = read_snapshot(tmp_path / "a.mcap")
    np.testing.assert_array_equal(snapshot.lidars[0].scans[0].points_m, scan.points_m)
    (note,) = snapshot.notes
    assert "'/a' gives its clouds a pose of their own in 'base_link'" in note


def _as_it_is(text: str) -> str:
    return text


def _data_first(text: str) -> str:
    table = json.loads(text)
    return json.dumps({"data": table.pop("data"), **table})


def _more_behind(text: str) -> str:
    return json.dumps({**json.loads(text), "note": 'not "data": "here"', "more": {"data": ""}})


def _spread(text: str) -> str:
    return json.dumps(json.loads(text), indent=4) + "\n"


def _escaped(text: str) -> str:
    return text.replace("/", "\\/")


@pytest.mark.parametrize("rewrite", [_as_it_is, _data_first, _more_behind, _spread, _escaped])
def test_json_may_be_written_in_any_way(scene: Snapshot, rewrite: Callable[[str], str]) -> None:
    scan = scene.lidars[0].scans[0]
    text = rewrite(json.dumps(json_cloud(scan, "lidar")))
    cloud = decode_cloud(RawMessage("/a", "foxglove.PointCloud", "json", 0, memoryview(text.encode()), "A scan"))
    np.testing.assert_array_equal(cloud.scan.points_m, scan.points_m)
    assert cloud.frame_id == "lidar"


def test_half_a_surrogate_pair_in_json_is_no_name(tmp_path: Path, scene: Snapshot) -> None:
    write_foxglove_json(Snapshot(scene.lidars[:1]), tmp_path / "a.mcap", frame_id="\ud800roof")
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert snapshot.names == ("?roof",)
    write_snapshot_mcap(snapshot, tmp_path / "b.mcap")
    assert read_snapshot(tmp_path / "b.mcap").names == ("?roof",)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"data": None}, "its JSON has no key 'data'"),
        ({"data": "?"}, "it is not JSON of a foxglove.PointCloud"),
        ({"fields": 3}, "it is not JSON of a foxglove.PointCloud"),
        ({"point_stride": 15}, "bytes of points of 15 bytes each"),
        ({"point_stride": 8}, "field z at byte 8 of points of 8 bytes"),
        ({"fields": []}, "has no field x or y or z"),
    ],
)
def test_broken_json(tmp_path: Path, scene: Snapshot, changes: dict[str, object], sentence: str) -> None:
    write_foxglove_json(scene, tmp_path / "a.mcap", **changes)
    with pytest.raises(UnreadableSourceError, match=r"^In .*a\.mcap, a scan of '/lidar_0/points' ") as caught:
        read_snapshot(tmp_path / "a.mcap")
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.bin", b"\0" * 15, "expected a multiple of 16: 4 float32 per point"),
        ("a.bin", bytes(range(240)), "has no coordinates"),
        ("a.pcd.bin", b"\0" * 16, "expected a multiple of 20: 5 float32 per point"),
        ("a.npy", b"\x93NUMPY\x01\0\x10\0{'shape': (3,", "has an invalid NumPy header"),
        ("a.las", b"LASF" + b"\0" * 100, "has a corrupt header: 0 records before the points"),
        ("a.las", b"LASF" + b"\0" * 400, "has a corrupt header"),
    ],
)
def test_broken_point_files(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UnreadableSourceError) as caught:
        read_snapshot(tmp_path / name)
    assert sentence in str(caught.value)


def test_arrays_that_are_no_points(tmp_path: Path) -> None:
    objects = np.array([[1, 2, "three"]], object)
    for array in (np.zeros(5), np.zeros((4, 2)), np.zeros((2, 2, 3)), np.zeros((2, 3), complex), objects):
        np.save(tmp_path / "a.npy", array, allow_pickle=True)
        with pytest.raises(UnreadableSourceError, match="; expected "):
            read_snapshot(tmp_path / "a.npy")


@pytest.mark.parametrize("name", ["a.las", "b.las", "a.laz", "b.laz"])
def test_a_las_file_cut_off_anywhere(tmp_path: Path, scene: Snapshot, name: str) -> None:
    POINT_WRITERS[name](scene.lidars[0].scans[0], tmp_path / name)
    content = (tmp_path / name).read_bytes()
    for size in range(4, len(content) - 20, 37):
        (tmp_path / name).write_bytes(content[:size])
        with pytest.raises(MultilicaError):
            read_snapshot(tmp_path / name)
