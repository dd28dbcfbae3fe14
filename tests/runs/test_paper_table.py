# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from multilica.errors import UsageError
from multilica.geometry import RigidTransform
from multilica.runs import Tolerances, Truth, read_run
from multilica.runs.paper_table import PaperTable, paper_table
from multilica.runs.pose_error import PoseError
from tests.runs.made_runs import Offset, made_truth, write_run

STILL = (0.0, 0.0, 0.0)
TRUTH = Truth("truth", made_truth())


def tabled(tmp_path: Path, *runs: dict[str, Offset | None], **limits: float) -> PaperTable:
    saved = [read_run(write_run(tmp_path / f"run{index}", offsets)) for index, offsets in enumerate(runs)]
    return paper_table(saved, [TRUTH], Tolerances(**limits))


def test_the_rotation_is_about_the_axes_of_the_lidar() -> None:
    true = RigidTransform.from_xyz_rpy("roof", "left", (1.0, 2.0, 3.0), (0.0, 0.0, math.pi / 2))
    turn = RigidTransform.from_xyz_rpy("left", "left", (0.0, 0.0, 0.0), np.deg2rad([2.0, -3.0, 5.0]).tolist())
    error = PoseError.between(true @ turn, true, about="source")
    np.testing.assert_allclose(np.rad2deg(error.rotation_rad), [2.0, -3.0, 5.0], atol=1e-9)
    np.testing.assert_allclose(error.translation_m, 0.0, atol=1e-12)


def test_the_translation_is_along_the_axes_of_the_target(tmp_path: Path) -> None:
    (one,) = tabled(tmp_path, {"left": ((0.01, -0.02, 0.03), STILL)}).rows
    assert one.error is not None
    np.testing.assert_allclose(one.error.translation_m, [0.01, -0.02, 0.03], atol=1e-9)


def test_the_rmse_goes_over_scenes_and_lidars(tmp_path: Path) -> None:
    table = tabled(
        tmp_path,
        {"left": ((0.003, 0.0, 0.0), STILL), "rear": ((-0.004, 0.0, 0.01), STILL)},
        {"left": (STILL, (0.0, 0.0, 0.06)), "rear": None},
    )
    overall = table.to_target
    assert (overall.poses, overall.placed, overall.successes) == (4, 3, 3)
    assert (overall.placed_rate, overall.success_rate) == (0.75, 0.75)
    np.testing.assert_allclose(
        [overall.rmse.x_m, overall.rmse.y_m, overall.rmse.z_m], np.sqrt([25e-6 / 3, 0.0, 1e-4 / 3]), atol=1e-12
    )
    assert overall.rmse.angle_deg == pytest.approx(0.06 / math.sqrt(3))
    left, rear = table.by_lidar
    assert left.rmse.x_m == pytest.approx(0.003 / math.sqrt(2))
    assert rear.placed == 1


def test_errors_that_two_lidars_share_vanish_between_them(tmp_path: Path) -> None:
    shared: Offset = ((0.05, 0.0, 0.0), STILL)
    table = tabled(tmp_path, {"left": shared, "rear": shared})
    found = {summary.pair: summary.rmse for summary in table.by_pair}
    assert list(found) == [("front", "left"), ("front", "rear"), ("left", "rear")]
    apart, common = found["front", "rear"], found["left", "rear"]
    assert np.linalg.norm([apart.x_m, apart.y_m, apart.z_m]) == pytest.approx(0.05)
    np.testing.assert_allclose([common.x_m, common.y_m, common.z_m], 0.0, atol=1e-9)
    assert (table.to_target.successes, table.between.successes) == (0, 1)


@pytest.mark.parametrize(
    ("offset", "limits", "success"),
    [
        (((0.02, 0.0, 0.0), STILL), {"within_m": 0.0201}, True),
        (((0.02, 0.0, 0.0), STILL), {"within_m": 0.0199}, False),
        (((0.015, 0.015, 0.0), STILL), {}, False),
        ((STILL, (0.0, 0.0, 0.2)), {"within_deg": 0.21}, True),
        ((STILL, (0.0, 0.0, 0.2)), {}, False),
    ],
)
def test_a_success_is_within_both_limits(
    offset: Offset, limits: dict[str, float], success: bool, tmp_path: Path
) -> None:
    (one,) = tabled(tmp_path, {"left": offset}, **limits).rows
    assert one.success is success


def test_an_uncertain_pose_is_not_placed(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", {"left": (STILL, STILL)}, sigmas=(0.5, 0.05), status="uncertain"))
    table = paper_table([run], [TRUTH])
    assert (table.to_target.poses, table.to_target.placed, table.to_target.rmse.x_m) == (1, 0, None)


def test_each_run_has_its_own_truth(tmp_path: Path) -> None:
    runs = [read_run(write_run(tmp_path / name, {"left": (STILL, STILL)})) for name in ("a", "b")]
    less = Truth("less", made_truth().__class__("base", {"front": made_truth().T_target_source["front"]}))
    table = paper_table(runs, [less, TRUTH])
    assert [one.run for one in table.rows] == [runs[1].name]
    assert [each.lidar for each in table.left_out if each.run == runs[0].name] == ["left"]
    with pytest.raises(UsageError, match="2 truths for 1 run"):
        paper_table(runs[:1], [less, TRUTH])


def test_the_document_names_units(tmp_path: Path) -> None:
    table = tabled(tmp_path, {"left": ((0.003, 0.0, 0.0), (0.0, 0.0, 0.05)), "rear": None})
    document = json.loads(table.model_dump_json())
    assert document["schema"] == "multilica/paper-table/1"
    assert document["to_target"]["rmse"]["x_m"] == pytest.approx(0.003)
    assert document["to_target"]["rmse"]["angle_deg"] == pytest.approx(0.05)
    assert document["to_target"]["success_rate"] == 0.5
    assert [row["x_m"] for row in document["rows"]] == [pytest.approx(0.003), None]
    assert [row["pair"] for row in document["by_pair"]] == [["front", "left"], ["front", "rear"], ["left", "rear"]]
