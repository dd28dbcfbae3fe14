# SPDX-License-Identifier: Apache-2.0
"""Bags of several files, whole and not."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from multilica.config import IngestConfig
from multilica.errors import UnreadableSourceError, UsageError
from multilica.ingest import inspect_source, read_snapshot
from multilica.snapshot import LidarScans, Snapshot
from tests.ingest.support.recording_writers import assert_same_points, make_snapshot, write_mcap, write_ros2_bag


def test_a_damaged_part_of_a_split_bag(tmp_path: Path) -> None:
    whole = make_snapshot(frames=4)
    (tmp_path / "bag").mkdir()
    write_mcap(whole, tmp_path / "bag" / "log_0.mcap")
    (tmp_path / "bag" / "log_1.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\0" * 20)
    snapshot = read_snapshot(tmp_path / "bag")
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [4, 4]
    assert any("log_1.mcap is damaged" in note for note in snapshot.notes)


def split_bag(folder: Path, storage: StoragePlugin) -> Snapshot:
    """Three parts that are packed as a whole, as `ros2 bag record` leaves them."""
    whole = make_snapshot(frames=6)
    folder.mkdir()
    for number in range(3):
        part = Snapshot(
            tuple(
                LidarScans(lidar.name, lidar.scans[2 * number : 2 * number + 2], topic=lidar.topic)
                for lidar in whole.lidars
            )
        )
        write_ros2_bag(part, folder / "part", storage, CompressionMode.FILE)
        (packed,) = (folder / "part").glob("*.zstd")
        packed.rename(folder / f"drive_{number}.{storage.name.lower()}.zstd")
        shutil.rmtree(folder / "part")
    return whole


def metadata(names: list[str]) -> str:
    listed = "".join(f"    - {name}\n" for name in names)
    return f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{listed}  files: []\n"


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_parts_of_a_split_bag_that_are_missing_are_told(tmp_path: Path, storage: StoragePlugin) -> None:
    whole = split_bag(tmp_path / "bag", storage)
    names = sorted(path.name for path in (tmp_path / "bag").iterdir())
    # A recorder that died leaves no metadata.yaml.
    assert_same_points(read_snapshot(tmp_path / "bag"), whole)
    for listed in (names, [name.removesuffix(".zstd") for name in names]):
        (tmp_path / "bag" / "metadata.yaml").write_text(metadata(listed), encoding="utf-8")
        snapshot = read_snapshot(tmp_path / "bag")
        assert_same_points(snapshot, whole)
        assert snapshot.notes == ()
    for left, name in ((4, names[1]), (2, names[0])):
        (tmp_path / "bag" / name).unlink()
        snapshot = read_snapshot(tmp_path / "bag")
        assert [len(lidar.scans) for lidar in snapshot.lidars] == [left, left]
        lost = min(set(names) - {path.name for path in (tmp_path / "bag").iterdir()}).removesuffix(".zstd")
        assert f"then the bag lacks {lost}, which its metadata.yaml names" in snapshot.notes[0]
    with pytest.raises(UnreadableSourceError, match=r"is refused, as ingest.strict is set: .* the bag lacks drive_0"):
        read_snapshot(tmp_path / "bag", config=IngestConfig(strict=True))


def test_what_lies_behind_a_damaged_part_is_used(tmp_path: Path) -> None:
    whole = make_snapshot(frames=4)
    (tmp_path / "bag").mkdir()
    for number in range(2):
        part = [LidarScans(lidar.name, lidar.scans[2 * number :][:2], topic=lidar.topic) for lidar in whole.lidars]
        write_mcap(Snapshot(tuple(part)), tmp_path / "bag" / f"log_{number}.mcap", compression=CompressionType.NONE)
    content = bytearray((tmp_path / "bag" / "log_0.mcap").read_bytes())
    content[content.index(whole.lidars[0].scans[1].points_m[0, :1].tobytes())] ^= 1
    (tmp_path / "bag" / "log_0.mcap").write_bytes(content)
    snapshot = read_snapshot(tmp_path / "bag", config=IngestConfig(frames=4))
    assert [scan.stamp_ns for scan in snapshot.lidars[0].scans] == [
        scan.stamp_ns for scan in (whole.lidars[0].scans[number] for number in (0, 2, 3))
    ]
    assert snapshot.notes[0].startswith("'/lidar_0/points' has lost scans in 1 place: ")


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_rolling_log_without_its_first_parts_is_read(tmp_path: Path, storage: StoragePlugin) -> None:
    whole = split_bag(tmp_path / "bag", storage)
    first, middle, _ = sorted((tmp_path / "bag").iterdir())
    first.unlink()
    snapshot = read_snapshot(tmp_path / "bag")
    later = Snapshot(tuple(replace(lidar, scans=lidar.scans[2:]) for lidar in whole.lidars))
    assert_same_points(snapshot, later)
    assert snapshot.notes == (f"The bag begins with {middle.name}: its first parts are not in the folder.",)
    assert inspect_source(tmp_path / "bag").notes == snapshot.notes
    assert read_snapshot(tmp_path / "bag", config=IngestConfig(strict=True)).names == whole.names


def test_a_rolling_log_may_lack_parts_between(tmp_path: Path) -> None:
    split_bag(tmp_path / "bag", StoragePlugin.MCAP)
    first, middle, _ = sorted((tmp_path / "bag").iterdir())
    first.rename(first.with_name("drive_10.mcap.zstd"))
    middle.unlink()
    (tmp_path / "bag" / "drive_2.mcap.zstd").rename(tmp_path / "bag" / "drive_12.mcap.zstd")
    snapshot = read_snapshot(tmp_path / "bag")
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [4, 4]
    told = "The bag begins with drive_10.mcap.zstd: its first parts are not in the folder, nor 1 between the others."
    assert snapshot.notes == (told,)


def test_numbered_drives_in_a_folder_are_no_rolling_log(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    for number, start_s in ((1, 0), (2, 60)):
        lidars = make_snapshot(seed=number).lidars
        for_a_drive = [
            replace(each, scans=tuple(replace(scan, stamp_ns=scan.stamp_ns + start_s * 10**9) for scan in each.scans))
            for each in lidars
        ]
        write_mcap(Snapshot(tuple(for_a_drive)), tmp_path / "logs" / f"drive_{number}.mcap")
    told = r"logs holds 2 recordings \(drive_1\.mcap, drive_2\.mcap\) with 59\.8 s between two of them"
    with pytest.raises(UsageError, match=told):
        read_snapshot(tmp_path / "logs")


@pytest.mark.parametrize("first", [0, 1])
def test_a_folder_of_recorders_is_no_split_bag(tmp_path: Path, first: int) -> None:
    (tmp_path / "log").mkdir()
    paths = [tmp_path / "log" / f"lidar_{number}.mcap" for number in (first, first + 1)]
    for path, lidar in zip(paths, make_snapshot().lidars, strict=True):
        write_mcap(Snapshot((lidar,)), path)
    with pytest.raises(UsageError, match="2 recordings of the same time"):
        read_snapshot(tmp_path / "log")
    assert len(read_snapshot(paths).lidars) == 2
    (tmp_path / "log" / "metadata.yaml").write_text(metadata([path.name for path in paths]), encoding="utf-8")
    assert len(read_snapshot(tmp_path / "log").lidars) == 2
