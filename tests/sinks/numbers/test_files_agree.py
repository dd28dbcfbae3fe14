# SPDX-License-Identifier: Apache-2.0
"""result.json and calibration.toml hold the numbers of the result."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

from multilica.results.document import parse_result
from tests.sinks.made_events import TRUTH
from tests.sinks.numbers import made_numbers as made
from tests.sinks.numbers.readers import assert_pose, pose_of, turn_of_rpy_deg

POSED = (made.FRONT, made.REAR)
BASE = pose_of((0.0, 0.0, made.GROUND_HEIGHT_M), turn_of_rpy_deg(made.GROUND_RPY_DEG))


@pytest.fixture(scope="module")
def document(numbered_files):
    return json.loads((numbered_files / "result.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def toml(numbered_files):
    return tomllib.loads((numbered_files / "calibration.toml").read_text(encoding="utf-8"))


def mm(values_mm):
    return pytest.approx(np.array(values_mm) / 1000.0)


@pytest.mark.parametrize("lidar", POSED)
def test_poses_and_figures_in_result_json(document, lidar):
    entry = document["lidars"][lidar]
    assert_pose(entry, TRUTH[lidar].matrix)
    assert entry["fitness"] == made.POSE_FITNESS[lidar]
    assert entry["rmse_m"] == mm(made.POSE_RMSE_MM[lidar])
    assert entry["sigma_xyz_m"] == mm(made.SIGMA_MM[lidar])
    assert entry["sigma_rotation_deg"] == pytest.approx(made.SIGMA_DEG[lidar])
    np.testing.assert_allclose(entry["covariance"], made.covariance_of(lidar), rtol=1e-12)
    spread = entry["spread"]
    assert spread["snapshots"] == made.SNAPSHOTS[lidar]
    assert spread["xyz_m"] == mm(made.SPREAD_MM[lidar])
    assert spread["rotation_deg"] == pytest.approx(made.SPREAD_DEG[lidar])


@pytest.mark.parametrize("lidar", POSED)
def test_priors_in_result_json(document, lidar):
    prior = document["lidars"][lidar]["prior"]
    turn = turn_of_rpy_deg((0.0, made.PRIOR_TURN_DEG[lidar], 0.0)) @ TRUTH[lidar].rotation
    shift_m = np.array([0.0, made.PRIOR_SHIFT_MM[lidar] / 1000.0, 0.0])
    assert_pose(prior, pose_of(TRUTH[lidar].xyz_m + shift_m, turn))
    assert prior["deviation_m"] == mm(made.PRIOR_SHIFT_MM[lidar])
    assert prior["deviation_deg"] == pytest.approx(made.PRIOR_TURN_DEG[lidar])


def test_pairs_in_result_json(document):
    pairs = {(pair["target"], pair["source"]): pair for pair in document["pairs"]}
    assert {*pairs} == {*made.PAIR_FITNESS}
    for (target, source), pair in pairs.items():
        key = (target, source)
        expected = np.linalg.inv(TRUTH[target].matrix) @ TRUTH[source].matrix
        assert_pose(pair, expected)
        assert (pair["fitness"], pair["rmse_m"]) == (made.PAIR_FITNESS[key], mm(made.PAIR_RMSE_MM[key]))
        best = pair["registrations"][0]
        assert tuple(best[name] for name in ("agree", "violate", "occluded", "unseen")) == made.PAIR_COUNTS[key]
        np.testing.assert_allclose(best["T_target_source"], expected, atol=1e-12)


def test_joint_figures_in_result_json(document):
    assert document["timing_s"] == made.SECONDS
    residuals = {
        (each["target"], each["source"]): (
            each["before_m"] * 1000.0,
            each["before_deg"],
            each["after_m"] * 1000.0,
            each["after_deg"],
            each["weight"],
        )
        for each in document["refinement"]["pairs"]
    }
    assert {*residuals} == {*made.RESIDUALS}
    assert all(residuals[pair] == pytest.approx(made.RESIDUALS[pair]) for pair in residuals)
    before_mm, before_deg, after_mm, after_deg, _ = np.max([*made.RESIDUALS.values()], axis=0)
    assert document["refinement"]["cycle_error_before"] == {"m": mm(before_mm), "deg": before_deg}
    assert document["refinement"]["cycle_error_after"] == {"m": mm(after_mm), "deg": after_deg}
    deviations = {
        each["name"]: {one["lidar"]: (one["distance_m"] * 1000.0, one["angle_deg"]) for one in each["deviations"]}
        for each in document["snapshots"]
    }
    for name, expected in made.DEVIATIONS.items():
        assert {lidar: pytest.approx(off) for lidar, off in expected.items()} == deviations[name]


def test_the_ground_is_the_same_in_both_files(document, toml):
    assert document["ground"]["offset_m"] == made.GROUND_HEIGHT_M
    assert document["ground"]["inlier_share"] == made.GROUND_SHARE
    for entry in (document["ground"], toml["ground"]):
        assert entry["area_m2"] == made.GROUND_AREA_M2
        assert (entry["residual_m"], entry["sigma_z_m"]) == (mm(made.GROUND_RESIDUAL_MM), mm(made.GROUND_SIGMA_MM))
        assert entry["sigma_roll_pitch_deg"] == list(made.GROUND_SIGMA_DEG)
        np.testing.assert_allclose(entry["T_base_target"], BASE, atol=1e-12)
    assert_pose(toml["ground"], BASE, "T_base_target")
    assert toml["ground"]["base"] == "base"
    assert toml["ground"]["rpy_deg"] == pytest.approx(made.GROUND_RPY_DEG)


def test_figures_of_the_stages_in_result_json(document):
    stages = document["stages"]
    for (target, source), fitness in made.PAIR_FITNESS.items():
        found = stages["fine"][f"{target} <- {source}"]
        assert_pose(found, np.linalg.inv(TRUTH[target].matrix) @ TRUTH[source].matrix)
        assert (found["fitness"], found["rmse_m"]) == (fitness, mm(made.PAIR_RMSE_MM[target, source]))
    assert {stages["merge"][step]["chosen"]: stages["merge"][step]["fitness"] for step in stages["merge"]} == {
        f"{made.TOP} <- {lidar}": fitness for lidar, fitness in made.MERGE_FITNESS.items()
    }
    for lidar in POSED:
        assert_pose(stages["refine"][lidar], TRUTH[lidar].matrix)
    assert stages["ground"]["plane"]["offset_m"] == made.GROUND_HEIGHT_M
    np.testing.assert_allclose(stages["ground"]["plane"]["normal"], BASE[2, :3], atol=1e-12)


def test_figures_of_the_search_in_result_json(document):
    stages = document["stages"]
    for stage, name, count in (
        ("ingest", "frames", 2),
        ("ingest", "points", 1200),
        ("preprocess", "returns", 1200),
        ("preprocess", "points", 600),
        ("features", "points", 400),
    ):
        assert {lidar: figures[name] for lidar, figures in stages[stage].items()} == dict.fromkeys(TRUTH, count)
    assert {figures["matches"] for figures in stages["correspond"].values()} == {80}
    assert {*stages["coarse"]} == {*stages["verify"]} == {*stages["correspond"]}
    for label, coarse in stages["coarse"].items():
        counts = (coarse["hypotheses"], coarse["graph_nodes"], coarse["graph_edges"], coarse["score"])
        assert counts == (2, 80, 200, 20)
        verify = stages["verify"][label]
        assert (verify["distinct"], verify["agree"], verify["violate"]) == (2, 90, 1)
        assert -3.0 < verify["evidence"] < 0.0  # that of the other pose is below -20
        target, source = label.split(" <- ")
        for figures in (coarse, verify):
            assert_pose(figures, np.linalg.inv(TRUTH[target].matrix) @ TRUTH[source].matrix)


def test_the_document_gives_pose_and_evidence_of_each_pair(document, numbered_files):
    text = (numbered_files / "result.json").read_text(encoding="utf-8")
    for pair, values in zip(parse_result("result.json", text).pairs, document["pairs"], strict=True):
        assert (pair.pose.target, pair.pose.source) == (values["target"], values["source"]) == pair.key
        assert pair.names == {values["target"], values["source"]}
        np.testing.assert_allclose(pair.pose.matrix, values["T_target_source"], atol=1e-12)
        assert pair.evidence == values["registrations"][0]["evidence"]
        assert pair.model_copy(update={"registrations": ()}).evidence == made.PAIR_FITNESS[pair.key]
        assert pair.verdict.accepted is (values["verdict"]["outcome"] == "accept")


@pytest.mark.parametrize(("table", "lidar"), [("lidars", made.FRONT), ("uncertain", made.REAR)])
def test_poses_and_figures_in_calibration_toml(toml, table, lidar):
    entry = toml[table][lidar]
    assert_pose(entry, TRUTH[lidar].matrix)
    assert {"xyz_m", "rpy_deg", "quaternion_xyzw"} <= {*entry}
    assert entry["fitness"] == made.POSE_FITNESS[lidar]
    assert entry["rmse_m"] == mm(made.POSE_RMSE_MM[lidar])
    assert entry["sigma_xyz_m"] == mm(made.SIGMA_MM[lidar])
    assert entry["sigma_rotation_deg"] == pytest.approx(made.SIGMA_DEG[lidar])
