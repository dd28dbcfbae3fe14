# SPDX-License-Identifier: Apache-2.0
"""Which sources are snapshots of their own."""

from __future__ import annotations

import shutil
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import SourceNotFoundError, UnknownNameError, UnreadableSourceError, UsageError
from multilica.ingest import find_snapshots, inspect_source, read_snapshot, require_lidar
from multilica.snapshot import Snapshot
from tests.ingest.support.recording_writers import make_snapshot, write_mcap, write_ros2_bag


def recording(path: Path, lidars: int = 2) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_mcap(make_snapshot(lidars, seed=zlib.crc32(bytes(path))), path)
    return path


def test_recordings_that_share_names_are_a_snapshot_each(tmp_path: Path) -> None:
    paths = [recording(tmp_path / "b.mcap"), recording(tmp_path / "a.mcap", lidars=3)]
    found = find_snapshots(paths)
    assert [(each.name, each.paths) for each in found] == [("b", (paths[0],)), ("a", (paths[1],))]
    assert read_snapshot(found[1].paths).names == ("lidar_0", "lidar_1", "lidar_2")


def test_a_lidar_that_only_one_snapshot_has_is_known(tmp_path: Path) -> None:
    found = find_snapshots([recording(tmp_path / "b.mcap"), recording(tmp_path / "a.mcap", lidars=3)])
    require_lidar("lidar_2", found)
    with pytest.raises(UnknownNameError, match=r"no LiDAR 'lidar_3' in .*b\.mcap, .*a\.mcap; available: lidar_0"):
        require_lidar("lidar_3", found)


def test_folders_with_a_bag_each_are_snapshots(tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        write_ros2_bag(make_snapshot(seed=len(name)), tmp_path / name)
    found = find_snapshots([tmp_path / "monday", tmp_path / "tuesday"])
    assert [each.name for each in found] == ["monday", "tuesday"]


def test_names_are_unique(tmp_path: Path) -> None:
    paths = [recording(tmp_path / name) for name in ("x/a.mcap", "y/a.mcap", "x_a.mcap")]
    names = [each.name for each in find_snapshots(paths)]
    assert names == ["x_a", "y_a", "x_a_3"]


def test_one_source_and_point_files_are_one_snapshot(tmp_path: Path) -> None:
    clouds = [tmp_path / "front.pcd", tmp_path / "rear.pcd"]
    for path in clouds:
        path.write_text("VERSION 0.7\n", encoding="utf-8")
    assert [each.paths for each in find_snapshots(clouds)] == [tuple(clouds)]
    one = recording(tmp_path / "a.mcap")
    assert [each.paths for each in find_snapshots([one])] == [(one,)]


def test_a_recorder_per_lidar_makes_one_snapshot(tmp_path: Path) -> None:
    paths = [tmp_path / "left.mcap", tmp_path / "right.mcap"]
    for path, lidar in zip(paths, make_snapshot().lidars, strict=True):
        write_mcap(Snapshot((lidar,)), path)
    (found,) = find_snapshots(paths)
    assert (found.name, found.paths) == ("left", tuple(paths))
    named = IngestConfig(topics={"front": "/lidar_0/points", "rear": "/lidar_1/points"})
    (found,) = find_snapshots(paths, config=named)
    assert read_snapshot(found.paths, config=named).names == ("front", "rear")


def test_recordings_of_which_only_some_share_lidars_are_refused(tmp_path: Path) -> None:
    first, second = recording(tmp_path / "a.mcap"), recording(tmp_path / "b.mcap")
    config = IngestConfig(topics={"front": "/lidar_0/points"})
    assert len(find_snapshots([first, second], config=config)) == 2
    apart = tmp_path / "c.mcap"
    lidars = (
        replace(lidar, name=name, frame_id=name) for lidar, name in zip(make_snapshot().lidars, "pq", strict=True)
    )
    write_mcap(Snapshot(tuple(lidars)), apart)
    with pytest.raises(UsageError, match=r"c.mcap has the LiDARs p, q, and none of those .* \(lidar_0, lidar_1\)"):
        find_snapshots([first, second, apart])


def test_what_is_wrong_with_the_paths_is_said(tmp_path: Path) -> None:
    one = recording(tmp_path / "a.mcap")
    with pytest.raises(UsageError, match="given more than once"):
        find_snapshots([one, tmp_path / "." / "a.mcap"])
    with pytest.raises(SourceNotFoundError, match="nowhere"):
        find_snapshots([one, tmp_path / "nowhere.mcap"])
    (tmp_path / "broken.mcap").write_bytes(one.read_bytes()[:60])
    with pytest.raises(UnreadableSourceError):
        find_snapshots([one, tmp_path / "broken.mcap"])


def folder(path: Path, *names: str) -> Path:
    """Point files of a few points each."""
    for name in names:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        np.save(path / name, np.full((3, 3), zlib.crc32(bytes(path / name)) % 1000, dtype=np.float32))
    return path


@pytest.mark.parametrize(
    "names",
    [
        ("front.npy", "rear.npy"),
        ("front_1.npy", "rear_2.npy", "top.npy"),
        ("front/0001.npy", "front/0002.npy", "rear/0001.npy"),
        ("lidar_0/0001.npy", "lidar_1/0001.npy"),
    ],
)
def test_folders_with_the_same_lidars_are_a_snapshot_each(tmp_path: Path, names: tuple[str, ...]) -> None:
    paths = [folder(tmp_path / stop, *names) for stop in ("stop1", "stop2", "stop3")]
    found = find_snapshots(paths)
    assert [(each.name, each.paths) for each in found] == [(path.name, (path,)) for path in paths]
    lidars = tuple(sorted({name.partition("/")[0].removesuffix(".npy") for name in names}))
    assert {each.lidars for each in found} == {lidars}
    assert all(read_snapshot(each.paths).names == lidars for each in found)
    assert set(inspect_source(paths).taken_for.values()) == {"LiDARs of one snapshot"}


def test_a_stop_may_lack_lidars(tmp_path: Path) -> None:
    names = ("front.npy", "rear.npy", "top.npy")
    paths = [folder(tmp_path / "stop1", *names), folder(tmp_path / "stop2", *names[:2])]
    assert [each.lidars for each in find_snapshots(paths)] == [("front", "rear", "top"), ("front", "rear")]


def test_stops_are_not_one_snapshot(tmp_path: Path) -> None:
    paths = [folder(tmp_path / stop, "front.npy", "rear.npy") for stop in ("stop1", "stop2")]
    with pytest.raises(UsageError, match=r"stop1, stop2 are several snapshots of one rig"):
        read_snapshot(paths)


def test_the_same_data_counts_once(tmp_path: Path) -> None:
    first, copy = recording(tmp_path / "a.mcap"), tmp_path / "b.mcap"
    copy.write_bytes(first.read_bytes())
    with pytest.raises(UsageError, match=r"a\.mcap and .*b\.mcap hold the same data"):
        find_snapshots([first, copy])
    stop = folder(tmp_path / "stop1", "front.npy", "rear.npy")
    with pytest.raises(UsageError, match="given more than once"):
        find_snapshots([stop, tmp_path / "." / "stop1"])
    shutil.copytree(stop, tmp_path / "stop2")
    with pytest.raises(UsageError, match=r"stop1 and .*stop2 hold the same data"):
        find_snapshots([stop, tmp_path / "stop2"])


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("0001.npy", "0002.npy"), ("0001.npy", "0002.npy")),
        (("frame_9.npy", "frame_10.npy"), ("frame_9.npy", "frame_10.npy")),
        (("scan.npy",), ("scan.npy",)),
        (("front.npy", "rear.npy"), ("front.npy", "top.npy")),
    ],
)
def test_folders_of_frames_are_a_lidar_each(tmp_path: Path, first: tuple[str, ...], second: tuple[str, ...]) -> None:
    paths = [folder(tmp_path / "left", *first), folder(tmp_path / "right", *second)]
    (found,) = find_snapshots(paths)
    assert found.paths == tuple(paths)
    snapshot = read_snapshot(found.paths)
    assert snapshot.names == ("left", "right")
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [len(first), len(second)]
    assert set(inspect_source(paths).taken_for.values()) == {"frames of one LiDAR"}

    assert read_snapshot(tmp_path).names == ("left", "right")


def test_a_folder_of_stops_is_no_folder_of_lidars(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    paths = [folder(drive / stop, "front.npy", "rear_2.npy", "0001.npy") for stop in ("stop1", "stop2")]
    folder(drive / "stop3", "front.npy", "rear_2.npy", "top.npy")
    told = rf"drive holds 3 folders .* \(front, rear_2\), as stops .*, as {drive}/\*/\. If each is a LiDAR, name its"
    for read in (read_snapshot, inspect_source):
        with pytest.raises(UsageError, match=told):
            read(drive)
    assert len(find_snapshots([*paths, drive / "stop3"])) == 3


def test_sources_are_taken_for_what_they_hold(tmp_path: Path) -> None:
    alone = folder(tmp_path / "stop", "front.npy", "rear.npy")
    assert inspect_source(alone).taken_for == {str(alone): "LiDARs of one snapshot"}
    clouds = [alone / "front.npy", alone / "rear.npy"]
    assert set(inspect_source(clouds).taken_for.values()) == {"a point cloud of one LiDAR"}
    log = recording(tmp_path / "a.mcap")
    assert inspect_source(log).taken_for == {str(log): "a recording"}


def test_further_stops_are_noted(tmp_path: Path) -> None:
    paths = [folder(tmp_path / stop, "front.npy", "rear.npy") for stop in ("stop1", "stop2")]
    summary = inspect_source(paths)
    assert summary.source == str(paths[0])
    assert [cloud.lidar for cloud in summary.clouds] == ["front", "rear"]
    assert f"{paths[1]} hold the same LiDARs: stops of one drive, a snapshot each." in summary.notes
