# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest
import tomli_w

from multilica.datasets import SceneRequest
from multilica.datasets.folders import AGREED, read_opencalib
from multilica.errors import InputError, SourceNotFoundError, UnreadableSourceError
from multilica.extrinsics import extrinsics_table
from tests import opencalib as real
from tests.cli.support import write_pcd
from tests.datasets.dataset_writers import write_opencalib

POINT = [[1.0, 2.0, 3.0]]


@pytest.mark.slow
def test_scenes_are_folders_and_names_end_at_the_hyphen(tmp_path: Path) -> None:
    for name in ("0002", "0001"):
        write_opencalib(tmp_path / name, keep_every=50)
    scenes = list(read_opencalib(tmp_path, SceneRequest()))
    assert [scene.name for scene in scenes] == ["0001", "0002"]
    for scene in scenes:
        assert (scene.target, scene.snapshot.names) == ("top", ("left", "right", "top"))
        assert scene.truth is AGREED
        assert scene.snapshot["top"].points_count > 0
        assert scene.snapshot.source_sha256
    assert len(list(read_opencalib(tmp_path, SceneRequest(scenes=1)))) == 1
    assert [scene.name for scene in read_opencalib(tmp_path / "0002", SceneRequest())] == ["0002"]


def test_a_given_truth_wins(tmp_path: Path) -> None:
    true = write_opencalib(tmp_path / "0001", keep_every=50)
    (tmp_path / "t.toml").write_text(tomli_w.dumps(extrinsics_table(true)))
    (scene,) = read_opencalib(tmp_path / "0001", SceneRequest(truth=tmp_path / "t.toml"))
    assert scene.truth is not None
    assert scene.truth.target == "base"


def test_other_lidars_have_no_truth(tmp_path: Path) -> None:
    for name in ("left", "qt"):
        write_pcd(tmp_path / f"{name}.pcd", POINT)
    (scene,) = read_opencalib(tmp_path, SceneRequest())
    assert (scene.target, scene.truth, scene.snapshot.names) == ("", None, ("left", "qt"))


def test_a_scene_here_has_the_name_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "0001").mkdir()
    write_pcd(tmp_path / "0001" / "top.pcd", POINT)
    write_pcd(tmp_path / "0001" / "left.pcd", POINT)
    monkeypatch.chdir(tmp_path / "0001")
    (scene,) = read_opencalib(Path(), SceneRequest())
    assert scene.name == "0001"


def test_a_folder_of_other_lidars_is_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_pcd(tmp_path / f"{name}.pcd", POINT)
    with pytest.raises(
        InputError, match=r"no scene with a LiDAR of the data set \(left, right, top\); .* such as top.pcd"
    ):
        list(read_opencalib(tmp_path, SceneRequest()))


def test_only_listed_files_are_read(tmp_path: Path) -> None:
    write_opencalib(tmp_path / "0001", keep_every=50)
    write_pcd(tmp_path / "0001" / "rear.pcd", POINT)
    (scene,) = read_opencalib(tmp_path, SceneRequest())
    assert "rear" not in scene.snapshot.names


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("device_id: 0\npath: data/top.pcd\n", r"names top.pcd, which is not there"),
        ("0 top.pcd\n", r"lists no file; expected 'device_id: N' and 'path: FILE' per LiDAR"),
    ],
)
def test_a_wrong_list_is_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    write_pcd(tmp_path / "left.pcd", POINT)
    (tmp_path / "lidar_cloud_path.txt").write_text(text)
    with pytest.raises(UnreadableSourceError, match=words):
        list(read_opencalib(tmp_path, SceneRequest()))


def test_what_is_no_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceNotFoundError, match="No folder at"):
        list(read_opencalib(tmp_path / "none", SceneRequest()))
    with pytest.raises(InputError, match="holds no scene"):
        list(read_opencalib(tmp_path, SceneRequest()))
    (tmp_path / "top.pcd").write_bytes(b"no points")
    with pytest.raises(UnreadableSourceError, match=r"top\.pcd"):
        list(read_opencalib(tmp_path, SceneRequest()))
    for name in ("top-1", "top-2"):
        write_pcd(tmp_path / "twice" / f"{name}.pcd", POINT)
    with pytest.raises(InputError, match=r"several files of one LiDAR \(top-1.pcd, top-2.pcd\)"):
        list(read_opencalib(tmp_path / "twice", SceneRequest()))


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    for name in ("left-1", "top-1"):
        write_pcd(tmp_path / f"{name}.pcd", POINT * 50)
    cut = (tmp_path / "top-1.pcd").read_bytes()[:-30]
    (tmp_path / "top-1.pcd").write_bytes(cut)
    with pytest.raises(UnreadableSourceError, match=r"top-1\.pcd has text that is not a table"):
        list(read_opencalib(tmp_path, SceneRequest()))


def test_a_name_with_a_control_character_is_read(tmp_path: Path) -> None:
    for name in ("left-\x01", "top-\x01"):
        write_pcd(tmp_path / f"{name}.pcd", POINT)
    (scene,) = read_opencalib(tmp_path, SceneRequest())
    assert scene.snapshot.names == ("left", "top")


@pytest.mark.skipif(not real.DATA.exists(), reason=real.MISSING)
def test_the_real_scans_are_a_scene() -> None:
    (scene,) = read_opencalib(real.DATA, SceneRequest())
    assert {lidar.name: lidar.points_count for lidar in scene.snapshot.lidars} == {
        "left": 8572,
        "right": 9248,
        "top": 92677,
    }
    for name in real.SOURCES:
        assert AGREED.between("top", name).distance_to(real.TRUTH[name]) == pytest.approx((0.0, 0.0), abs=1e-9)
