# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, ndtr, ndtri

from multilica import read_extrinsics
from multilica.errors import InputError, UnreadableSourceError, UsageError
from multilica.geometry import RigidTransform
from multilica.runs import Evaluation, Tolerances, Truth, evaluate, read_run
from multilica.runs.evaluation import ErrorFigures
from multilica.runs.pose_error import PoseError, as_sigma, normalised_error
from tests.runs.made_runs import Offset, covariance, made_truth, write_run, write_truth

STILL = (0.0, 0.0, 0.0)
TRUTH = Truth("truth", made_truth())


def evaluated(tmp_path: Path, *runs: dict[str, Offset | None], truth: Truth = TRUTH) -> Evaluation:
    saved = [read_run(write_run(tmp_path / f"run{index}", offsets)) for index, offsets in enumerate(runs)]
    return evaluate(saved, [truth])


def test_errors_are_those_that_were_made(tmp_path: Path) -> None:
    evaluation = evaluated(tmp_path, {"left": ((0.01, -0.02, 0.03), (1.0, -2.0, 3.0))})
    (one,) = evaluation.lidars
    assert one.error is not None
    np.testing.assert_allclose(one.error.translation_m, [0.01, -0.02, 0.03], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(one.error.rotation_rad), [1.0, -2.0, 3.0], atol=1e-9)
    assert one.error.distance_m == pytest.approx(math.sqrt(14) / 100)


@pytest.mark.parametrize("angle_deg", [1e-6, 0.1, 90.0, 179.0])
def test_the_angle_is_that_of_the_relative_rotation(angle_deg: float) -> None:
    true = made_truth().between("front", "rear")
    turned = true @ RigidTransform.from_xyz_rpy("rear", "rear", STILL, (0.0, math.radians(angle_deg), 0.0))
    assert math.degrees(PoseError.between(turned, true).angle_rad) == pytest.approx(angle_deg, rel=1e-6)


def test_rmse_goes_over_lidars_and_runs(tmp_path: Path) -> None:
    offsets = [{"left": ((0.003, 0, 0), STILL), "rear": ((-0.004, 0, 0), STILL)}, {"left": (STILL, STILL)}]
    overall = evaluated(tmp_path, *offsets).overall
    assert overall.rmse.x_m == pytest.approx(math.sqrt((9e-6 + 16e-6) / 3))
    assert overall.median.x_m == pytest.approx(0.003)
    assert overall.largest.x_m == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("offset", "outcome"),
    [
        ((STILL, STILL), "within"),
        (((0.0199, 0, 0), (0, 0, 0.099)), "within"),
        (((0.0201, 0, 0), STILL), "between"),
        ((STILL, (0.101, 0, 0)), "between"),
        (((0.0499, 0, 0), (0, 0.499, 0)), "between"),
        (((0.0501, 0, 0), STILL), "false_accept"),
        ((STILL, (0, 0.501, 0)), "false_accept"),
        (None, "false_refuse"),
    ],
)
def test_outcomes(tmp_path: Path, offset: Offset | None, outcome: str) -> None:
    evaluation = evaluated(tmp_path, {"left": offset})
    assert [one.outcome for one in evaluation.lidars] == [outcome]
    assert getattr(evaluation.overall, outcome) == evaluation.overall.lidars == 1


@pytest.mark.parametrize(
    ("offset_m", "sigma_m", "outcome"),
    [
        (0.003, None, "within"),
        (0.003, 0.001, "within"),
        (0.003, 0.0006, "within"),
        (0.003, 0.0005, "false_accept"),
        (0.03, 0.01, "between"),
        (0.06, 0.06, "false_accept"),
    ],
)
def test_more_than_four_sigma_is_a_false_accept(
    tmp_path: Path, offset_m: float, sigma_m: float | None, outcome: str
) -> None:
    sigmas = None if sigma_m is None else (0.05, sigma_m)
    run = read_run(write_run(tmp_path / "run", {"left": ((0.0, offset_m, 0.0), STILL)}, sigmas=sigmas))
    (one,) = evaluate([run], [TRUTH]).lidars
    assert one.outcome == outcome
    assert (one.error_sigma is None) == (sigma_m is None)


@pytest.mark.parametrize(
    ("offset_m", "sigma_m", "outcome"),
    [(0.3, 0.2, "uncertain_within"), (0.003, 0.0005, "uncertain_beyond")],
)
def test_an_uncertain_pose_is_held_against_its_own_sigma(
    tmp_path: Path, offset_m: float, sigma_m: float, outcome: str
) -> None:
    offsets = {"left": ((0.0, offset_m, 0.0), STILL)}
    file = write_run(tmp_path / "run", offsets, sigmas=(0.05, sigma_m), status="uncertain") / "result.json"
    evaluation = evaluate([read_run(file)], [TRUTH])
    overall = evaluation.overall
    assert [one.outcome for one in evaluation.lidars] == [outcome]
    assert getattr(overall, outcome) == overall.lidars == 1
    assert (overall.within, overall.false_accept, overall.false_refuse, overall.rmse.x_m) == (0, 0, 0, None)
    assert evaluation.runs.faultless == 0
    (row,) = evaluation.lidars
    assert (row.placed, row.uncertain, row.error_distance_m) == (False, True, pytest.approx(offset_m))


@pytest.mark.slow
def test_sigma_is_as_rare_as_for_one_normal_variable() -> None:
    rng = np.random.default_rng(1)
    true = made_truth().between("front", "rear")
    spread = rng.normal(size=(6, 6)) * np.repeat([1e-3, 1e-2], 3)[:, None]
    figures = []
    for draw in rng.normal(size=(4000, 6)) @ spread.T:
        turn = Rotation.from_rotvec(draw[:3]).as_matrix() @ true.rotation
        found = RigidTransform.from_rotation_translation("front", "rear", turn, true.xyz_m + draw[3:])
        figures.append(normalised_error(found, true, spread @ spread.T))
    assert np.mean(np.square(figures)) == pytest.approx(1.0, abs=0.03)
    for sigma in (0.5, 1.0, 2.0, 3.0):
        assert np.mean([as_sigma(figure) > sigma for figure in figures]) == pytest.approx(2.0 * ndtr(-sigma), abs=0.02)


@pytest.mark.parametrize("mahalanobis", [0.0, 1e-9, 0.5, 3.0, 8.0])
def test_sigma_is_the_equal_quantile_of_chi_square(mahalanobis: float) -> None:
    true = made_truth().between("front", "rear")
    found = RigidTransform.from_rotation_translation(
        "front", "rear", true.rotation, true.xyz_m + np.array([0.0, 0.01 * mahalanobis, 0.0])
    )
    expected = -ndtri(chdtrc(6, mahalanobis**2) / 2.0)
    normalised = normalised_error(found, true, covariance(0.1, 0.01))
    assert normalised == pytest.approx(mahalanobis / math.sqrt(6.0))
    assert as_sigma(normalised) == pytest.approx(expected, abs=1e-6)


def test_sigma_of_a_pose_metres_off_is_a_number() -> None:
    true = made_truth().between("front", "rear")
    found = RigidTransform.from_rotation_translation(
        "front", "rear", true.rotation, true.xyz_m + np.array([9.0, 0.0, 0.0])
    )
    assert as_sigma(normalised_error(found, true, covariance(0.1, 0.001))) == pytest.approx(9000.0, rel=1e-3)


@pytest.mark.parametrize("damage", [[[1.0]], np.zeros((6, 6)).tolist(), [[None] * 6] * 6, [["a"] * 6] * 6])
def test_a_covariance_that_is_none_is_refused(tmp_path: Path, damage: object) -> None:
    file = write_run(tmp_path / "run", {"left": (STILL, STILL)}) / "result.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    document["lidars"]["left"]["covariance"] = damage
    file.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(UnreadableSourceError, match="is not a whole result"):
        read_run(file)


def test_nothing_placed_has_no_statistics(tmp_path: Path) -> None:
    overall = evaluated(tmp_path, {"left": None}).overall
    assert overall.false_refuse == 1
    assert {overall.rmse, overall.median, overall.largest} == {ErrorFigures()}


def test_what_only_one_side_has_is_left_out(tmp_path: Path) -> None:
    truth = Truth("t.toml", read_extrinsics(write_truth(tmp_path / "t.toml", ["front", "rear"])))
    evaluation = evaluated(tmp_path, {"left": (STILL, STILL), "rear": None}, {"rear": None}, {}, truth=truth)
    assert [one.lidar for one in evaluation.lidars] == ["rear", "rear"]
    told = [(Path(left.run).name, left.lidar, left.reason) for left in evaluation.left_out]
    assert told == [
        ("run0", "left", "t.toml does not have it"),
        ("run2", "rear", "t.toml has it, the run does not"),
    ]


def test_a_run_whose_target_the_truth_lacks_is_left_out(tmp_path: Path) -> None:
    truth = Truth("t.toml", read_extrinsics(write_truth(tmp_path / "t.toml", ["left", "rear"])))
    known = read_run(write_run(tmp_path / "known", {"rear": (STILL, STILL)}, target="left"))
    unknown = read_run(write_run(tmp_path / "unknown", {"rear": (STILL, STILL)}, target="front"))
    evaluation = evaluate([unknown, known], [truth])
    assert (evaluation.runs.compared, evaluation.runs.faultless) == (1, 1)
    assert {one.run for one in evaluation.lidars} == {known.name}
    assert [(left.lidar, left.reason) for left in evaluation.left_out] == [
        (None, "t.toml does not have its target 'front'")
    ]
    with pytest.raises(InputError, match=r"No LiDAR of .*unknown can be compared with the truth: t\.toml does not"):
        evaluate([unknown], [truth])


def test_each_run_has_its_own_truth(tmp_path: Path) -> None:
    shifted = Truth("shifted", made_truth())
    poses = dict(shifted.extrinsics.T_target_source)
    poses["left"] = RigidTransform.from_rotation_translation(
        "base", "left", poses["left"].rotation, poses["left"].xyz_m + 1.0
    )
    shifted = Truth("shifted", type(shifted.extrinsics)("base", poses))
    runs = [read_run(write_run(tmp_path / name, {"left": (STILL, STILL)})) for name in ("a", "b")]
    outcomes = [one.outcome for one in evaluate(runs, [TRUTH, shifted]).lidars]
    assert outcomes == ["within", "false_accept"]


def test_wrong_requests(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", {"left": (STILL, STILL)}))
    with pytest.raises(UsageError, match="Found 2 truths for 1 run; expected one"):
        evaluate([run], [TRUTH, TRUTH])
    with pytest.raises(UsageError, match="is given more than once"):
        evaluate([run, run], [TRUTH])
    for limits in (
        {"within_m": 0.0},
        {"within_m": 0.06},
        {"wrong_deg": float("nan")},
        {"wrong_m": float("inf")},
        {"wrong_sigma": 0.0},
        {"wrong_sigma": float("nan")},
    ):
        with pytest.raises(UsageError, match="expected limits above zero"):
            Tolerances(**limits)
