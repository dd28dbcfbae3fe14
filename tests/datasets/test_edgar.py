# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.datasets import SceneRequest, folders
from multilica.datasets.folders import read_edgar
from multilica.errors import InputError, SourceNotFoundError, UnreadableSourceError
from multilica.simulate import Simulation, simulate_snapshot
from tests.cli.support import write_pcd
from tests.datasets.dataset_writers import truth_yaml
from tests.ingest.support.recording_writers import write_ros2_bag

NAMES = {"left": "main_lidar", "front": "lidar_1", "right": "lidar_2", "rear": "lidar_3"}
TOPICS = {name: f"/lidar/{lidar}/points" for lidar, name in NAMES.items()}


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_snapshot("edgar", "street", 4, frames=3, sensors="ideal")


def write_truth(folder: Path, simulation: Simulation, names: dict[str, str] = NAMES) -> None:
    (folder / "config.yaml").write_text(truth_yaml(simulation.truth, "left", names))


@pytest.mark.slow
def test_bags_with_the_truth_of_the_authors(simulation: Simulation, tmp_path: Path) -> None:
    for scene in ("scene_01", "scene_02"):
        write_ros2_bag(simulation.snapshot, tmp_path / scene)
    write_truth(tmp_path, simulation)
    scenes = list(read_edgar(tmp_path, SceneRequest(frames=2, topics=TOPICS)))
    assert [scene.name for scene in scenes] == ["scene_01", "scene_02"]
    for scene in scenes:
        assert (scene.target, set(scene.snapshot.names)) == ("main_lidar", set(NAMES.values()))
        assert {len(lidar.scans) for lidar in scene.snapshot.lidars} == {2}
        assert scene.truth is not None
        true = simulation.truth.between("left", "rear")
        assert scene.truth.between("main_lidar", "lidar_3").distance_to(true) == pytest.approx((0.0, 0.0), abs=1e-7)


@pytest.mark.slow
def test_one_bag_alone(simulation: Simulation, tmp_path: Path) -> None:
    write_ros2_bag(simulation.snapshot, tmp_path / "bag")
    (scene,) = read_edgar(tmp_path / "bag", SceneRequest(frames=3))
    assert (scene.name, scene.target, scene.truth) == ("bag", "", None)
    for lidar in scene.snapshot.lidars:
        np.testing.assert_array_equal(lidar.scans[0].points_m, simulation.snapshot[lidar.name].scans[0].points_m)
    assert [note for note in scene.snapshot.notes if note.startswith("The vehicle stands still")]
    (file,) = (tmp_path / "bag").glob("*.db3")
    assert [each.name for each in read_edgar(file, SceneRequest())] == [file.stem]


@pytest.mark.slow
def test_folders_of_point_files(simulation: Simulation, tmp_path: Path) -> None:
    for scene in ("b", "a"):
        for lidar, name in NAMES.items():
            write_pcd(tmp_path / scene / f"{name}.pcd", simulation.snapshot[lidar].scans[0].points_m[::50])
    write_truth(tmp_path, simulation)
    write_truth(tmp_path / "a", simulation, {"left": "main_lidar", "rear": "lidar_3"})
    a, b = read_edgar(tmp_path, SceneRequest())
    assert (a.name, b.name, b.snapshot.names) == ("a", "b", tuple(sorted(NAMES.values())))
    assert a.truth is not None
    assert b.truth is not None
    assert (len(a.truth.members), len(b.truth.members)) == (3, 5)
    assert len(list(read_edgar(tmp_path, SceneRequest(scenes=1)))) == 1


def write_frames(folder: Path, lidars: tuple[str, ...] = ("main_lidar", "lidar_1")) -> None:
    for lidar in lidars:
        for frame in ("0001", "0002"):
            write_pcd(folder / lidar / f"{frame}.pcd", [[1, 2, 3]])


def test_folders_of_frames_are_lidars_of_a_scene(tmp_path: Path) -> None:
    for scene in ("b", "a"):
        write_frames(tmp_path / scene)
    (tmp_path / "notes").mkdir()
    a, b = read_edgar(tmp_path, SceneRequest())
    (alone,) = read_edgar(tmp_path / "a", SceneRequest())
    assert (a.name, b.name, alone.name) == ("a", "b", "a")
    for scene in (a, b, alone):
        assert {lidar.name: len(lidar.scans) for lidar in scene.snapshot.lidars} == {"main_lidar": 2, "lidar_1": 2}


@pytest.mark.parametrize(
    "scenes",
    [
        {"scene_1": ["main_lidar", "lidar_1"], "scene_2": ["main_lidar"]},
        {"scene_1": ["lidar_1", "lidar_2"], "scene_2": ["lidar_1", "lidar_2"]},
        {"scene_1": ["main_lidar"]},
    ],
)
def test_lidars_with_numbers_are_no_frames(tmp_path: Path, scenes: dict[str, list[str]]) -> None:
    for scene, lidars in scenes.items():
        for lidar in lidars:
            write_pcd(tmp_path / scene / f"{lidar}.pcd", [[1, 2, 3]])
    found = folders._sources(tmp_path)
    assert [each.name for each in found] == [*scenes]


def test_a_scene_alone_in_its_folder_is_found(tmp_path: Path) -> None:
    for lidar in ("main_lidar", "lidar_1"):
        write_pcd(tmp_path / "a" / f"{lidar}.pcd", [[1, 2, 3]])
    (scene,) = read_edgar(tmp_path, SceneRequest())
    assert (scene.name, scene.snapshot.names) == ("a", ("lidar_1", "main_lidar"))


@pytest.mark.slow
def test_a_given_truth_wins(simulation: Simulation, tmp_path: Path) -> None:
    write_pcd(tmp_path / "scene" / "main_lidar.pcd", [[1, 2, 3]])
    write_truth(tmp_path / "scene", simulation)
    other = tmp_path / "other"
    other.mkdir()
    write_truth(other, simulation, {"left": "main_lidar", "rear": "back"})
    (scene,) = read_edgar(tmp_path / "scene", SceneRequest(truth=other / "config.yaml"))
    assert scene.truth is not None
    assert scene.truth.members == {"truth", "main_lidar", "back"}


def test_scenes_of_one_stem_have_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("one.mcap", "one.bag", "two.mcap"):
        (tmp_path / name).touch()
    monkeypatch.setattr(folders, "read_snapshot", lambda *_, **__: None)
    monkeypatch.setattr(folders, "find_source", lambda _: SimpleNamespace(recordings=[]))
    names = [each.name for each in read_edgar(tmp_path, SceneRequest())]
    assert names == ["one.bag", "one.mcap", "two"]


def test_what_is_no_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceNotFoundError, match="Nothing exists at"):
        list(read_edgar(tmp_path / "none", SceneRequest()))
    with pytest.raises(InputError, match="holds no scene; expected ROS 2 bags"):
        list(read_edgar(tmp_path, SceneRequest()))
    (tmp_path / "drive.db3").write_bytes(b"SQLite format 3\0 and no more")
    with pytest.raises(UnreadableSourceError, match=r"drive\.db3"):
        list(read_edgar(tmp_path, SceneRequest()))
