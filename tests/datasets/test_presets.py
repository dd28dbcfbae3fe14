# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from multilica import events
from multilica.datasets import DatasetDocument, DatasetScene, SceneRequest, published, run_presets
from multilica.datasets.folders import read_opencalib
from multilica.datasets.scene import read_truth
from multilica.errors import UnknownNameError, UsageError
from multilica.runs import Tolerances
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.datasets.dataset_writers import write_opencalib

LIMITS = Tolerances(0.05, 0.5)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[DatasetDocument, Path, list[str]]:
    """Both presets on a scene with truth, without truth, and one that is refused."""
    folder = tmp_path_factory.mktemp("presets")
    truth = write_opencalib(folder / "data" / "0001")
    (known,) = read_opencalib(folder / "data", SceneRequest())
    cloud = LidarScans("top", (Scan(np.ones((10, 3), np.float32)),))
    scenes = [
        DatasetScene("known", known.snapshot, truth, "top"),
        DatasetScene("unknown", known.snapshot, None, "top"),
        DatasetScene("alone", Snapshot((cloud,)), truth, "top"),
    ]
    seen: list[str] = []

    def observe(event: events.RunEvent) -> None:
        if isinstance(event, events.SnapshotStarted):
            seen.append(event.name)

    settings = ["fine.max_points=9000"]
    return (
        run_presets(
            "opencalib",
            scenes,
            ["default", "paper", "default"],
            folder / "out",
            LIMITS,
            settings=settings,
            observe=observe,
        ),
        (folder / "out"),
        seen,
    )


@pytest.mark.slow
def test_every_scene_runs_with_every_preset(found: tuple[DatasetDocument, Path, list[str]]) -> None:
    runs, out, seen = found
    assert runs.scenes == ("known", "unknown", "alone")
    assert list(runs.presets) == ["default", "paper"]
    assert seen == [f"{scene}, preset {name}" for scene in runs.scenes for name in ("default", "paper")]
    for name in ("default", "paper"):
        config = json.loads((out / "known" / name / "result.json").read_text())["config"]
        assert (config["preset"], config["target"], config["runtime"]["workers"]) == (name, "top", 1)
        assert config["fine"]["max_points"] == 9000
    assert (out / "unknown" / "default" / "result.json").is_file()
    assert read_truth(out / "known" / "truth.toml").members >= {"top", "left", "right"}
    assert not (out / "unknown" / "truth.toml").exists()


@pytest.mark.slow
def test_tables_cover_the_scenes_with_truth(found: tuple[DatasetDocument, Path, list[str]]) -> None:
    default, paper = found[0].presets.values()
    assert default.median_stages_s is not None
    assert 0.0 < default.median_stages_s < 100.0
    assert default.table is not None
    assert {row.run for row in default.table.rows} == {str(found[1] / "known" / "default")}
    assert (default.table.to_target.poses, default.table.to_target.successes) == (2, 2)
    assert paper.table is not None


@pytest.mark.slow
def test_what_is_left_out_is_told(found: tuple[DatasetDocument, Path, list[str]]) -> None:
    runs = found[0]
    assert runs.without_truth == ("unknown",)
    assert [(one.scene, one.preset) for one in runs.refused] == [("alone", "default"), ("alone", "paper")]
    assert "only one LiDAR (top)" in runs.refused[0].reason


@pytest.mark.slow
def test_the_document_has_a_table_per_preset(found: tuple[DatasetDocument, Path, list[str]]) -> None:
    document = json.loads(found[0].model_dump_json())
    assert document["schema"] == "multilica/dataset/1"
    assert list(document["presets"]) == ["default", "paper"]
    assert document["presets"]["default"]["table"]["to_target"]["successes"] == 2
    assert [each["scene"] for each in document["refused"]] == ["alone", "alone"]
    assert document["published"]["table"]["to_target"]["poses"] == 2


@pytest.mark.slow
def test_without_any_truth_there_is_no_table(found: tuple[DatasetDocument, Path, list[str]]) -> None:
    document = run_presets("helipr", [], ["default"], found[1], LIMITS)
    assert document.presets["default"].table is None
    assert document.presets["default"].median_stages_s is None


def test_wrong_requests_fail_before_a_scene_is_read(tmp_path: Path) -> None:
    def never() -> object:
        pytest.fail("a scene was read")
        yield

    with pytest.raises(UnknownNameError, match="no preset 'papr'"):
        run_presets("edgar", never(), ["papr"], tmp_path, LIMITS)
    with pytest.raises(UsageError, match=r"fine\.none"):
        run_presets("edgar", never(), ["default"], tmp_path, LIMITS, settings=["fine.none=1"])
    with pytest.raises(UsageError, match="Found 0 scenes of 5 frames"):
        SceneRequest(scenes=0)


def test_the_authors_example_has_its_known_errors() -> None:
    """Differences of the numbers in the published evaluation file, in millimetres."""
    table = published("edgar").table
    assert table is not None
    errors = {one.source: one.error for one in table.rows}
    assert all(error is not None for error in errors.values())
    found_mm = {name: 1e3 * error.translation_m for name, error in errors.items() if error is not None}
    np.testing.assert_allclose(found_mm["lidar_1"], [3.805, 9.908, -5.169], atol=2e-3)
    np.testing.assert_allclose(found_mm["lidar_3"], [42.378, -1.157, 9.286], atol=2e-3)
    assert published("helipr").table is None


def test_the_published_code_is_as_far_off_as_measured() -> None:
    table = published("opencalib").table
    assert table is not None
    found = {one.source: one.error for one in table.rows}
    for name, distance_m, angle_deg in (("left", 0.03403, 0.064206), ("right", 0.012938, 0.107689)):
        error = found[name]
        assert error is not None
        assert np.linalg.norm(error.translation_m) == pytest.approx(distance_m, abs=1e-5)
        assert math.degrees(error.angle_rad) == pytest.approx(angle_deg, abs=1e-4)
