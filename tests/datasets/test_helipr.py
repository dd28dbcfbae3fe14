# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.datasets import DatasetScene, SceneRequest
from multilica.datasets.helipr import LAST_SHORT_AEVA_NS, ScanFiles, point_layout, read_scenes
from multilica.errors import InputError, SourceNotFoundError, UnfitSnapshotError, UnreadableSourceError
from tests.datasets.dataset_writers import (
    DRIVE,
    FIRST_STOP,
    FOLDERS,
    PERIOD_NS,
    START_NS,
    packed,
    true_extrinsics,
    write_helipr,
)

REQUEST = SceneRequest(frames=3)
SECOND_STOP_NS = START_NS + (FIRST_STOP + DRIVE) * PERIOD_NS


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_helipr(tmp_path_factory.mktemp("helipr") / "KAIST05")


@pytest.fixture(scope="module")
def scenes(sequence: Path) -> list[DatasetScene]:
    return list(read_scenes(sequence, REQUEST))


@pytest.fixture
def damaged(sequence: Path, tmp_path: Path) -> Iterator[Path]:
    copy = tmp_path / "KAIST05"
    shutil.copytree(sequence, copy)
    yield copy
    shutil.rmtree(copy)


@pytest.mark.parametrize(
    ("lidar", "stamp_ns", "point_bytes"),
    [
        ("Ouster", 1, 26),
        ("Velodyne", 1, 22),
        ("Avia", 1, 19),
        ("Aeva", LAST_SHORT_AEVA_NS, 25),
        ("Aeva", LAST_SHORT_AEVA_NS + 1, 29),
    ],
)
def test_each_layout_is_read(lidar: str, stamp_ns: int, point_bytes: int, tmp_path: Path) -> None:
    points_m = np.random.default_rng(1).normal(scale=30.0, size=(500, 3)).astype(np.float32)
    data = packed(lidar, stamp_ns, points_m, intensity=42.0, ring=9)
    assert len(data) == 500 * point_bytes == 500 * point_layout(lidar, stamp_ns).row_bytes
    (tmp_path / f"{stamp_ns}.bin").write_bytes(data)
    scan = ScanFiles(lidar, tmp_path, np.array([stamp_ns])).read(stamp_ns)
    np.testing.assert_array_equal(scan.points_m, points_m)
    assert scan.intensity is not None
    assert set(scan.intensity.tolist()) == {42.0}
    assert set(scan.rings.tolist()) == {9}
    assert scan.stamp_ns == stamp_ns


@pytest.mark.slow
def test_scenes_are_stops(scenes: list[DatasetScene]) -> None:
    first, second = (int(scene.name) for scene in scenes)
    assert START_NS <= first < START_NS + (FIRST_STOP - 4) * PERIOD_NS
    assert second >= SECOND_STOP_NS
    for scene in scenes:
        assert (scene.target, scene.snapshot.names) == ("Ouster", ("Aeva", "Avia", "Ouster", "Velodyne"))
        assert all(len(lidar.scans) == 3 for lidar in scene.snapshot.lidars)
        stamps_ns = [scan.stamp_ns for lidar in scene.snapshot.lidars for scan in lidar.scans]
        assert min(stamps_ns) - int(scene.name) >= 0
        assert max(stamps_ns) - int(scene.name) < 4 * PERIOD_NS


@pytest.mark.slow
def test_the_longest_stop_comes_first(sequence: Path, scenes: list[DatasetScene]) -> None:
    (one,) = read_scenes(sequence, replace(REQUEST, scenes=1))
    assert one.name == scenes[0].name


@pytest.mark.slow
def test_the_truth_is_that_of_the_poses(scenes: list[DatasetScene]) -> None:
    for scene in scenes:
        assert scene.truth is not None
        assert scene.truth.members == set(FOLDERS)
        for name in ("Velodyne", "Avia", "Aeva"):
            true = true_extrinsics().between("Ouster", name)
            shift_m, turn_rad = scene.truth.between("Ouster", name).distance_to(true)
            assert shift_m < 1e-6
            assert turn_rad < 1e-8


@pytest.mark.slow
def test_a_folder_above_the_sequence_will_do(sequence: Path, scenes: list[DatasetScene]) -> None:
    assert [scene.name for scene in read_scenes(sequence.parent, REQUEST)] == [scene.name for scene in scenes]


@pytest.mark.slow
def test_without_poses_the_scans_tell_the_stops(tmp_path: Path) -> None:
    sequence = write_helipr(tmp_path / "unknown", with_poses=())
    found = list(read_scenes(sequence, REQUEST))
    assert [scene.truth for scene in found] == [None] * len(found)
    assert found
    drive_ns = range(START_NS + (FIRST_STOP - 4) * PERIOD_NS, SECOND_STOP_NS)
    assert not [scene.name for scene in found if int(scene.name) in drive_ns]


@pytest.mark.slow
def test_a_lidar_without_poses_is_not_in_the_truth(damaged: Path) -> None:
    (damaged / "LiDAR_GT" / "Aeva_gt.txt").unlink()
    scene = next(read_scenes(damaged, REQUEST))
    assert scene.truth is not None
    assert scene.truth.members == {"Ouster", "Velodyne", "Avia"}
    assert "Aeva" in scene.snapshot.names


@pytest.mark.slow
def test_without_poses_of_the_reference_another_is_the_target(damaged: Path, scenes: list[DatasetScene]) -> None:
    assert scenes[0].target == "Ouster"
    (damaged / "LiDAR_GT" / "Ouster_gt.txt").unlink()
    scene = next(read_scenes(damaged, REQUEST))
    assert scene.truth is not None
    assert (scene.target, scene.truth.target) == ("Velodyne", "Velodyne")
    assert "The truth has no pose of Ouster: Velodyne is the target, to which errors refer." in scene.snapshot.notes


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_vehicle_that_drives_all_the_time_is_refused(tmp_path: Path) -> None:
    for poses in (tuple(FOLDERS), ()):
        sequence = write_helipr(tmp_path / f"drive{len(poses)}", with_poses=poses, stops=False)
        with pytest.raises(UnfitSnapshotError, match=r"never stands still for 0\.4 s"):
            list(read_scenes(sequence, REQUEST))


@pytest.mark.slow
def test_poses_that_claim_a_stop_are_checked_by_scans(tmp_path: Path) -> None:
    sequence = write_helipr(tmp_path / "drive", stops=False)
    for file in (sequence / "LiDAR_GT").iterdir():
        words = [line.split() for line in file.read_text().splitlines()]
        file.write_text("".join(" ".join([line[0], *words[0][1:]]) + "\n" for line in words))
    with pytest.raises(UnfitSnapshotError, match="never stands still"):
        list(read_scenes(sequence, REQUEST))


@pytest.mark.slow
def test_missing_scans_are_noted(damaged: Path, scenes: list[DatasetScene]) -> None:
    (damaged / "LiDAR" / "Aeva" / f"{scenes[0].snapshot['Aeva'].scans[1].stamp_ns}.bin").unlink()
    late = scenes[0].snapshot["Avia"].scans[0].stamp_ns
    for file in (damaged / "LiDAR" / "Avia").iterdir():
        if abs(int(file.stem) - late) < 10 * PERIOD_NS:
            file.unlink()
    found = next(read_scenes(damaged, REQUEST)).snapshot
    assert found.names == ("Aeva", "Ouster", "Velodyne")
    assert [note.split(" from ")[0] for note in found.notes] == ["Avia has 0 of 3 scans"]
    assert len(found["Aeva"].scans) == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "has 0 bytes; expected points of 26 bytes"),
        (b"\x01" * 1000, "has 1000 bytes; expected points of 26 bytes each, as HeLiPR's Ouster"),
        (np.random.default_rng(0).bytes(26 * 500), "has no coordinates where HeLiPR's Ouster has them"),
    ],
)
def test_a_damaged_scan_is_one_sentence(data: bytes, words: str, damaged: Path) -> None:
    for file in (damaged / "LiDAR" / "Ouster").iterdir():
        file.write_bytes(data)
    with pytest.raises(UnreadableSourceError, match=words) as caught:
        list(read_scenes(damaged, REQUEST))
    assert str(caught.value).count("\n") == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "0 lines that are not poses"),
        ("1 2 3\n4 5 6\n", "2 lines that are not poses"),
        ("one 1 2 3 0 0 0 1\n", "invalid literal"),
        ("1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "do not increase"),
        ("1 1 2 3 0 0 0 0\n2 1 2 3 0 0 0 0\n", "zero norm"),
        ("1 1 2 3 0 0 0 1\n2 nan 2 3 0 0 0 1\n", "2 lines that are not poses"),
        ("99999999999999999999 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n", "too large"),
        ("1 1 2 3 0 0 0 1\n2 1 2\n", "inhomogeneous"),
        ("\u20ac\n", "can't decode"),
    ],
)
def test_damaged_poses_are_one_sentence(text: str, words: str, damaged: Path) -> None:
    (damaged / "LiDAR_GT" / "Ouster_gt.txt").write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableSourceError, match=rf"Ouster_gt.txt is not a trajectory \(.*{words}") as caught:
        list(read_scenes(damaged, REQUEST))
    assert str(caught.value).count("\n") == 0


def test_another_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceNotFoundError, match="No folder at"):
        list(read_scenes(tmp_path / "none", REQUEST))
    with pytest.raises(InputError, match="is not a HeLiPR sequence: it has no folder LiDAR"):
        list(read_scenes(tmp_path, REQUEST))
    (tmp_path / "LiDAR" / "Ouster").mkdir(parents=True)
    (tmp_path / "LiDAR" / "Ouster" / "notes.bin").write_bytes(b"")
    with pytest.raises(InputError, match="has scans of no LiDAR"):
        list(read_scenes(tmp_path, REQUEST))
    for name in ("KAIST05", "DCC05"):
        (tmp_path / "all" / name / "LiDAR").mkdir(parents=True)
    with pytest.raises(InputError, match=r"holds several sequences \(DCC05, KAIST05\)"):
        list(read_scenes(tmp_path / "all", REQUEST))
