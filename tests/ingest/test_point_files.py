# SPDX-License-Identifier: Apache-2.0
"""PCD and PLY files of every storage, written by Open3D where it can."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import UnreadableSourceError
from multilica.ingest import read_snapshot
from multilica.registration.lazy_open3d import o3d
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import Scan
from tests.ingest.support.recording_writers import make_snapshot

STORAGES = {
    "ascii.pcd": {"write_ascii": True},
    "binary.pcd": {},
    "compressed.pcd": {"compressed": True},
    "binary.ply": {},
}
HEADER = "VERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {type}\n{count}WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {data}\n"


def a_scan() -> Scan:
    return make_snapshot(points=200).lidars[0].scans[0]


def write_by_open3d(path: Path, scan: Scan, **options: bool) -> None:
    cloud = o3d.t.geometry.PointCloud()
    cloud.point.positions = o3d.core.Tensor(np.array(scan.points_m))
    cloud.point.intensity = o3d.core.Tensor(np.array(scan.intensity)[:, None])
    assert o3d.t.io.write_point_cloud(str(path), cloud, **options)


def read_one(path: Path) -> Scan:
    (lidar,) = read_snapshot(path).lidars
    (scan,) = lidar.scans
    assert scan.stamp_ns == 0
    return scan


def header(
    n: int, data: str, fields: str = "x y z", size: str = "4 4 4", kind: str = "F F F", count: str = ""
) -> bytes:
    return HEADER.format(n=n, data=data, fields=fields, size=size, type=kind, count=count).encode()


@pytest.mark.parametrize("name", STORAGES)
def test_files_of_open3d(tmp_path: Path, name: str) -> None:
    scan = a_scan()
    write_by_open3d(tmp_path / name, scan, **STORAGES[name])
    found = read_one(tmp_path / name)
    np.testing.assert_array_equal(found.points_m, scan.points_m)
    np.testing.assert_array_equal(found.intensity, scan.intensity)


def test_ascii_ply_of_open3d_has_six_digits(tmp_path: Path) -> None:
    scan = a_scan()
    write_by_open3d(tmp_path / "a.ply", scan, write_ascii=True)
    np.testing.assert_allclose(read_one(tmp_path / "a.ply").points_m, scan.points_m, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("storage", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_with_an_element_before_and_lists_after_the_vertices(tmp_path: Path, storage: str) -> None:
    scan = a_scan()
    order = ">" if storage == "binary_big_endian" else "<"
    dtype = np.dtype([("nx", order + "i2"), ("z", order + "f8"), ("x", order + "f8"), ("y", order + "f8")])
    records = np.zeros(len(scan.points_m), dtype)
    records["x"], records["y"], records["z"] = scan.points_m.T
    if storage == "ascii":
        lines = ["7 8", *(" ".join(repr(value.item()) for value in row) for row in records), "3 0 1 2"]
        body = ("\n".join(lines) + "\n").encode()
    else:
        body = np.array([7, 8], order + "u4").tobytes() + records.tobytes() + b"\x03" + b"\0" * 12
    head = (
        f"ply\nformat {storage} 1.0\ncomment by hand\nelement sensor 1\nproperty uint a\nproperty uint32 b\n"
        f"element vertex {len(records)}\nproperty short nx\nproperty double z\nproperty float64 x\nproperty double y\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    np.testing.assert_array_equal(read_one(tmp_path / "a.ply").points_m, scan.points_m)


def test_pcd_without_count_with_blank_ends_and_windows_lines(tmp_path: Path) -> None:
    head = header(2, "ascii").replace(b"\n", b"\r\n")
    (tmp_path / "a.pcd").write_bytes(b"# comment\r\n" + head + b"1 2 3 \r\n\r\nnan 0 0\r\n")
    np.testing.assert_array_equal(read_one(tmp_path / "a.pcd").points_m, [[1.0, 2.0, 3.0]])


def test_pcd_with_padding_doubles_and_wide_fields(tmp_path: Path) -> None:
    dtype = np.dtype([("pad", "u1", 3), ("x", "<f8"), ("hist", "<f4", 5), ("y", "<f8"), ("z", "<f8"), ("t", "<u8")])
    records = np.zeros(3, dtype)
    records["x"], records["y"], records["z"] = np.arange(9.0).reshape(3, 3)
    head = header(3, "binary", "_ x hist y z t", "1 8 4 8 8 8", "U F F F F U", "COUNT 3 1 5 1 1 1\n")
    (tmp_path / "a.pcd").write_bytes(head + records.tobytes())
    np.testing.assert_array_equal(read_one(tmp_path / "a.pcd").points_m, np.arange(9.0).reshape(3, 3).T)


def test_points_that_are_not_finite_are_dropped_in_order(tmp_path: Path) -> None:
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    points[[0, 4], [1, 2]] = np.nan
    points[9, 0] = np.inf
    (tmp_path / "a.pcd").write_bytes(header(10, "binary") + points.tobytes())
    np.testing.assert_array_equal(read_one(tmp_path / "a.pcd").points_m, points[[1, 2, 3, 5, 6, 7, 8]])


def test_a_folder_of_frames_per_lidar(tmp_path: Path) -> None:
    frames = [np.full((2, 3), number, np.float32) for number in range(1, 13)]
    for name, count in (("front", 12), ("rear", 1)):
        (tmp_path / name).mkdir()
        for number, points in enumerate(frames[:count]):
            (tmp_path / name / f"scan_{number}.pcd").write_bytes(header(2, "binary") + points.tobytes())
    (tmp_path / "notes.txt").write_text("not a cloud")
    snapshot = read_snapshot(tmp_path, config=IngestConfig(frames=11))
    assert snapshot.names == ("front", "rear")
    assert [scan.points_m[0, 0] for scan in snapshot["front"].scans] == list(range(1, 12))
    assert len(snapshot["rear"].scans) == 1
    assert snapshot["rear"].topic == "rear"
    assert snapshot.notes == ("'rear' has 1 scan in the window, others have more.",)


def test_a_list_of_files_and_folders(tmp_path: Path) -> None:
    body = header(2, "binary") + np.ones((2, 3), np.float32).tobytes()
    for name in ("front/0001.pcd", "rear/0001.pcd", "roof.pcd"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(body)
    files = read_snapshot([tmp_path / "front/0001.pcd", tmp_path / "rear/0001.pcd", tmp_path / "roof.pcd"])
    assert files.names == ("front_0001", "rear_0001", "roof")
    assert read_snapshot([tmp_path / "front", tmp_path / "roof.pcd"]).names == ("front", "roof")


def test_files_can_be_chosen_and_renamed(tmp_path: Path) -> None:
    for name in ("a.pcd", "b.pcd", "c.pcd"):
        (tmp_path / name).write_bytes(header(2, "binary") + np.ones((2, 3), np.float32).tobytes())
    config = IngestConfig(topics={"roof": "c.pcd", "front": "a.pcd"})
    assert read_snapshot(tmp_path, config=config).names == ("front", "roof")


def test_a_broken_frame_among_good_ones_is_told(tmp_path: Path) -> None:
    (tmp_path / "front").mkdir()
    for number in range(3):
        (tmp_path / "front" / f"{number}.pcd").write_bytes(header(2, "binary") + np.ones((2, 3), np.float32).tobytes())
    (tmp_path / "front" / "1.pcd").write_bytes(header(2, "binary") + b"\0" * 5)
    snapshot = read_snapshot(tmp_path)
    assert len(snapshot["front"].scans) == 2
    (note,) = snapshot.notes
    assert "1 of 3 scans of 'front' are broken and left out" in note
    assert "1.pcd ends after 0 of its 2 points" in note


PCD = header(4, "binary") + np.ones((4, 3), np.float32).tobytes()
BROKEN = {
    "a.pcd": [
        (header(4, "binary") + b"\0" * 47, "ends after 3 of its 4 points"),
        (header(10**15, "binary") + b"\0" * 48, "ends after 4 of its 1000000000000000 points"),
        (header(10**15, "ascii") + b"1 2 3\n", "ends after 1 of its 1000000000000000 points"),
        (header(4, "ascii") + b"1 2 3\n4 5 six\n7 8 9\n1 1 1\n", "has text that is not a table of points"),
        (header(4, "ascii") + b"1 2 3\n4 5\n7 8 9\n1 1 1\n", "has text that is not a table of points"),
        (header(4, "binary_compressed") + b"\0\0", "ends before its compressed data begin"),
        (header(4, "binary_compressed") + b"\x09\0\0\0\x30\0\0\0\0\0", "ends after 2 of its 9 compressed bytes"),
        (
            header(4, "binary_compressed") + b"\x02\0\0\0\x30\0\0\0\xff\xff",
            "compressed data that cannot be unpacked",
        ),
        (header(4, "binary_compressed") + b"\x02\0\0\0\x31\0\0\0\xff\xff", "unpack to 49; expected 48"),
        (
            header(357913941, "binary_compressed") + b"\x02\0\0\0\xfc\xff\xff\xff\xff\xff",
            "2 bytes unpack to 4294967292",
        ),
        (header(4, "zipped") + b"\0" * 48, "has DATA zipped"),
        (header(4, "binary", "x y i") + b"\0" * 48, "has no field z; its fields are: x, y, i"),
        (header(4, "binary", kind="F F Q") + b"\0" * 48, "has field z of the unknown datatype"),
        (header(4, "binary", size="4 4") + b"\0" * 48, "missing or differ in length"),
        (PCD.replace(b"WIDTH 4", b"WIDTH 5"), "claims 4 points in its header, but 5 x 1"),
        (PCD.replace(b"WIDTH 4", b"WIDTH -4"), "header line 'WIDTH -4'"),
        (PCD.replace(b"DATA binary\n", b""), "has no line DATA"),
        (b"", "is empty"),
        (b"ply\nformat ascii 1.0\n", "is a PLY file, yet named like a PCD file"),
        (b"\x89MCAP0\r\n" + b"\0" * 50, "is an MCAP file, yet named like a PCD file"),
        (bytes(range(200, 256)), "is not a PCD file, although its name says so"),
    ],
    "a.ply": [
        (b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n2\n", "has no field y or z"),
        (b"ply\nformat ascii 2.0\nelement face 2\nend_header\n", "has no element vertex"),
        (b"ply\nformat binary 1.0\nelement vertex 2\nend_header\n", "has format 'binary'"),
        (b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\n", "has no line end_header"),
        (b"ply\nformat ascii 1.0\nelement vertex two\nend_header\n", "has 'two' in its header"),
        (b"ply\nformat ascii 1.0\nelement vertex 2\nproperty quad x\nend_header\n", "unknown property 'quad x'"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 2\nproperty list int int x\nend_header\n",
            "lists among its vertices",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nproperty float y\n"
            b"property float z\nend_header\n" + b"\0" * 30,
            "ends after 2 of its 999999999999 points",
        ),
    ],
}


@pytest.mark.parametrize(
    ("name", "content", "sentence"), [(name, *case) for name, cases in BROKEN.items() for case in cases]
)
def test_broken_files_give_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str, content: bytes, sentence: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnreadableSourceError) as caught:
        read_snapshot(path)
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(f"{path} ")
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_broken_file_does_not_cost_the_others(tmp_path: Path) -> None:
    np.save(tmp_path / "front.npy", np.ones((5, 3)))
    (tmp_path / "rear.bin").write_bytes(b"\0" * 1001)
    found = read_snapshot(tmp_path)
    assert found.names == ("front",)
    (note,) = found.notes
    assert note.startswith("1 of 1 scans of 'rear.bin' are broken and left out: ")
    for config in (IngestConfig(strict=True), IngestConfig(only=("rear.bin",)), IngestConfig(topics={"a": "rear.bin"})):
        with pytest.raises(UnreadableSourceError, match="has 1001 bytes; expected a multiple of 16"):
            read_snapshot(tmp_path, config=config)
    (tmp_path / "front.npy").unlink()
    with pytest.raises(UnreadableSourceError, match="has 1001 bytes; expected a multiple of 16"):
        read_snapshot(tmp_path)


def test_a_table_with_a_column_per_point_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "front.npy", np.ones((3, 5000), np.float32))
    with pytest.raises(UnreadableSourceError, match="holds 3 x 5000 numbers; expected a row per point: transpose it"):
        read_snapshot(tmp_path)


def test_files_whose_names_are_no_utf8(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"\xfc")
    folder.mkdir()
    for name in (b"l\xfcnks.npy", b"rechts.npy"):
        with (folder / os.fsdecode(name)).open("wb") as file:
            np.save(file, np.ones((5, 3), np.float32))
    snapshot = read_snapshot(folder)
    assert snapshot.names == ("l?nks", "rechts")
    assert snapshot.source == "?"
    write_snapshot_mcap(snapshot, tmp_path / "a.mcap")
    assert read_snapshot(tmp_path / "a.mcap").names == snapshot.names
