# SPDX-License-Identifier: Apache-2.0
"""The number of a point's laser comes through every format that has it, with the right point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.ingest import read_snapshot
from multilica.ingest.messages import foxglove
from multilica.pointcloud2 import PointCloud2, PointField, decode_points, encode_points
from multilica.sinks import snapshots
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.messages.test_ouster import frame_of, ouster_messages, sensor
from tests.ingest.support import format_writers, recording_writers
from tests.ingest.support.format_writers import livox_messages, velodyne_messages, write_raw_mcap
from tests.ingest.support.recording_writers import make_snapshot, rings_of

_XYZ = tuple(PointField(axis, 4 * index, 7) for index, axis in enumerate("xyz"))
_POINTS = np.arange(1.0, 13.0, dtype=np.float32).reshape(4, 3)


def _with_rings(snapshot: Snapshot) -> Snapshot:
    return Snapshot(
        tuple(
            LidarScans(
                lidar.name,
                tuple(
                    Scan(scan.points_m, scan.stamp_ns, scan.intensity, rings=rings_of(scan), times_ns=rings_of(scan))
                    for scan in lidar.scans
                ),
                topic=lidar.topic,
            )
            for lidar in snapshot.lidars
        )
    )


def _livox(driver: str, encoding: str) -> Callable[[Snapshot, Path], None]:
    return lambda scene, path: write_raw_mcap(livox_messages(scene, driver, encoding), path, encoding)


_RECORDINGS: dict[str, Callable[[Snapshot, Path], None]] = {
    "snapshot.mcap": snapshots.write_snapshot_mcap,
    "ours.mcap": snapshots.write_ros2_mcap,
    "ours.bag": snapshots.write_ros1_bag,
    "ours": snapshots.write_ros2_bag,
    "driver.mcap": recording_writers.write_mcap_ros2,
    "driver_of_ros1.mcap": format_writers.write_mcap_ros1,
    "livox.mcap": _livox("livox_ros_driver2", "cdr"),
    "livox_of_ros1.mcap": _livox("livox_ros_driver", "ros1"),
}


@pytest.mark.parametrize("name", _RECORDINGS)
def test_recordings_keep_the_rings(tmp_path: Path, name: str) -> None:
    _RECORDINGS[name](_with_rings(make_snapshot()), tmp_path / name)
    for lidar in read_snapshot(tmp_path / name).lidars:
        for scan in lidar.scans:
            assert scan.rings is not None
            assert scan.rings.dtype == np.uint16
            np.testing.assert_array_equal(scan.rings, rings_of(scan))


def test_our_recordings_have_the_fields_of_a_driver() -> None:
    (scan,) = _with_rings(make_snapshot(lidars=1, frames=1)).lidars[0].scans
    cloud = encode_points(scan.points_m, scan.intensity, rings=scan.rings, times_ns=scan.times_ns)
    found = [(field.name, field.datatype) for field in cloud.fields]
    assert found == [("x", 7), ("y", 7), ("z", 7), ("intensity", 7), ("t", 6), ("ring", 4)]
    times_ns = np.ndarray(cloud.width, "<u4", cloud.data, cloud.fields[4].offset, (cloud.point_step,))
    np.testing.assert_array_equal(times_ns, scan.times_ns)


def _pcd(fields: str, sizes: str, kinds: str, data: str) -> bytes:
    return (
        f"VERSION 0.7\nFIELDS x y z {fields}\nSIZE 4 4 4 {sizes}\nTYPE F F F {kinds}\nWIDTH 4\nHEIGHT 1\n"
        f"POINTS 4\nDATA {data}\n"
    ).encode()


def _records(name: str, kind: str, values: list[float]) -> np.ndarray:
    records = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("other", "<f8"), (name, kind)])
    for axis, column in zip("xyz", _POINTS.T, strict=True):
        records[axis] = column
    records[name] = values
    return records


def _rings_in(path: Path, content: bytes) -> np.ndarray | None:
    path.write_bytes(content)
    (scan,) = read_snapshot(path).lidars[0].scans
    np.testing.assert_array_equal(scan.points_m, _POINTS)
    return scan.rings


@pytest.mark.parametrize("name", ["ring", "channel", "line", "laser_id"])
def test_point_files_keep_the_rings_under_every_name(tmp_path: Path, name: str) -> None:
    records = _records(name, "<u2", [3, 0, 65535, 7])
    text = "\n".join(" ".join(repr(value.item()) for value in row) for row in records) + "\n"
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 4\n{_properties(name)}end_header\n".encode()
    contents = {
        "binary.pcd": _pcd(f"other {name}", "8 2", "F U", "binary") + records.tobytes(),
        "ascii.pcd": _pcd(f"other {name}", "8 2", "F U", "ascii") + text.encode(),
        "binary.ply": head + records.tobytes(),
        "ascii.ply": head.replace(b"binary_little_endian", b"ascii") + text.encode(),
    }
    for file, content in contents.items():
        np.testing.assert_array_equal(_rings_in(tmp_path / file, content), [3, 0, 65535, 7])


def _properties(name: str) -> str:
    kinds = {"x": "float", "y": "float", "z": "float", "other": "double", name: "ushort"}
    return "".join(f"property {kind} {each}\n" for each, kind in kinds.items())


def test_arrays_keep_the_rings(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", _records("ring", ">i4", [3, 0, 1, 7]))
    (scan,) = read_snapshot(tmp_path / "a.npy").lidars[0].scans
    np.testing.assert_array_equal(scan.rings, [3, 0, 1, 7])
    (given,) = make_snapshot(lidars=1, frames=1).lidars[0].scans
    format_writers.write_nuscenes(given, tmp_path / "a.pcd.bin")
    (scan,) = read_snapshot(tmp_path / "a.pcd.bin").lidars[0].scans
    np.testing.assert_array_equal(scan.rings, rings_of(given))


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("<f4", [3.0, 0.0, 1.0, 7.0], [3, 0, 1, 7]),
        ("<i4", [3, 0, 70_000, 7], None),
        ("<i2", [3, 0, -1, 7], None),
        ("<f4", [3.0, 0.5, 1.0, 7.0], None),
        ("<f8", [3.0, np.nan, 1.0, 7.0], None),
    ],
)
def test_numbers_that_are_no_rings_are_left_out(
    tmp_path: Path, kind: str, values: list[float], expected: list[int] | None
) -> None:
    records = _records("ring", kind, values)
    head = _pcd("other ring", f"8 {kind[2]}", f"F {kind[1].upper()}", "binary")
    np.testing.assert_array_equal(_rings_in(tmp_path / "a.pcd", head + records.tobytes()), expected)


@pytest.mark.parametrize("field", [PointField("ring", 12, 9), PointField("ring", 15, 4)])
def test_a_field_that_cannot_be_read_leaves_the_points(field: PointField) -> None:
    padded = np.hstack([_POINTS, np.full((4, 1), 5.0, np.float32)])
    found = decode_points(PointCloud2((*_XYZ, field), 4, 1, 16, 64, padded.tobytes()))
    np.testing.assert_array_equal(found.points_m, _POINTS)
    assert found.rings is None
    # Another name that can be read stands in for it.
    other = decode_points(PointCloud2((*_XYZ, field, PointField("line", 12, 7)), 4, 1, 16, 64, padded.tobytes()))
    np.testing.assert_array_equal(other.rings, [5, 5, 5, 5])


def test_rings_go_with_points_that_are_not_finite() -> None:
    points_m = _POINTS.copy()
    points_m[1, 2] = np.nan
    found = decode_points(encode_points(points_m, rings=np.arange(4, dtype=np.uint16)))
    np.testing.assert_array_equal(found.points_m, _POINTS[[0, 2, 3]])
    np.testing.assert_array_equal(found.rings, [0, 2, 3])


def test_clouds_of_foxglove_keep_the_rings() -> None:
    cloud = encode_points(_POINTS, rings=np.array([4, 3, 2, 1], np.uint16))
    codes = {7: 7, 4: 3}
    table = {
        "timestamp": {"sec": 1},
        "point_stride": cloud.point_step,
        "fields": [{"name": each.name, "offset": each.offset, "type": codes[each.datatype]} for each in cloud.fields],
        "data": format_writers.base64.b64encode(bytes(cloud.data)).decode(),
    }
    data = format_writers.json.dumps(table).encode()
    message = SimpleNamespace(encoding="json", data=data, log_time_ns=1, timed=False)
    np.testing.assert_array_equal(foxglove.decode_cloud(message).scan.rings, [4, 3, 2, 1])


def test_rings_of_velodyne_rise_with_the_elevation(tmp_path: Path) -> None:
    write_raw_mcap(velodyne_messages("cdr"), tmp_path / "a.mcap", "cdr")
    (scan,) = read_snapshot(tmp_path / "a.mcap").lidars[0].scans
    heights_m = [scan.points_m[scan.rings == ring, 2] for ring in range(16)]
    assert sum(map(len, heights_m)) == len(scan.points_m)
    assert max(np.ptp(each) for each in heights_m) < 0.05
    assert np.all(np.diff([each.mean() for each in heights_m]) > 0.1)


def test_rings_of_ouster_are_rows(tmp_path: Path) -> None:
    info = sensor()
    frame = frame_of(info, 0)
    write_raw_mcap(ouster_messages(info, [frame]), tmp_path / "a.mcap", "cdr")
    (scan,) = read_snapshot(tmp_path / "a.mcap").lidars[0].scans
    rows, _ = np.nonzero(frame.field("RANGE"))
    np.testing.assert_array_equal(scan.rings, rows)


def test_rings_of_all_frames() -> None:
    lidar = _with_rings(make_snapshot(lidars=1)).lidars[0]
    np.testing.assert_array_equal(lidar.rings, np.concatenate([rings_of(scan) for scan in lidar.scans]))
    assert len(lidar.rings) == lidar.points_count
    empty = Scan(np.empty((0, 3), np.float32))
    np.testing.assert_array_equal(LidarScans("a", (*lidar.scans, empty)).rings, lidar.rings)
    assert LidarScans("a", (*lidar.scans, Scan(_POINTS))).rings is None
    assert LidarScans("a", (empty,)).rings is None


def test_some_points_of_a_scan() -> None:
    scan = Scan(_POINTS, 5, rings=[1, 2, 3, 4], times_ns=[10, 20, 30, 40])
    for kept in (np.array([True, False, True, False]), slice(0, None, 2)):
        some = scan.selected(kept)
        np.testing.assert_array_equal(some.points_m, _POINTS[::2])
        assert (some.rings.tolist(), some.times_ns.tolist(), some.intensity, some.stamp_ns) == (
            [1, 3],
            [10, 30],
            None,
            5,
        )
    assert scan.nbytes == 4 * (12 + 2 + 4)
    with pytest.raises(ValueError, match="expected rings of 4 points, found shape"):
        Scan(_POINTS, rings=[1, 2])
