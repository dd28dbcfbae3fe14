# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from multilica.config import STAGES
from multilica.errors import InputError
from multilica.geometry import RigidTransform
from multilica.runs.difference import RunDifference, changes_between, compare_runs, stage_differences
from multilica.runs.run_documents import RunDocument
from tests.sinks.made_documents import made_document, parsed
from tests.sinks.made_events import LIDARS, TARGET, TRUTH

WITHIN = {"within_m": 1e-4, "within_rad": math.radians(1e-3)}


def run_of(document, name="run"):
    return RunDocument(Path(name), parsed(document), None)


def differences(before, after):
    return compare_runs(run_of(before, "A"), run_of(after, "B"), **WITHIN)


def moved(document, lidar, shift_m):
    """The document with that LiDAR elsewhere, along the target's axes."""
    matrix = np.array(document["lidars"][lidar]["T_target_source"])
    matrix[:3, 3] += shift_m
    document["lidars"][lidar]["T_target_source"] = matrix.tolist()
    return document


def test_a_run_does_not_differ_from_itself():
    found = differences(made_document(), made_document())
    assert found.same
    assert found.differences == {}
    assert [*found.moves] == ["front left/1", "rear"]
    assert all(move.distance_m == 0.0 for move in found.moves.values())


def test_a_move_is_told_in_metres_degrees_and_sigma():
    documents = made_document(), moved(made_document(), "rear", (0.0, 0.03, 0.0))
    for document, sigma_m in zip(documents, (0.006, 0.008), strict=True):
        document["lidars"]["rear"]["covariance"] = np.diag([1e-6] * 3 + [sigma_m**2] * 3).tolist()
        document["lidars"]["front left/1"]["covariance"] = None
    still, rear = differences(*documents).moves.values()
    assert (still.moved, rear.moved) == (False, True)
    np.testing.assert_allclose(rear.translation_m, (0.0, 0.03, 0.0), atol=1e-12)
    assert rear.sigmas == pytest.approx(3.0)
    assert still.sigmas is None


def test_the_limits_decide_what_has_moved():
    after = moved(made_document(), "rear", (5e-5, 0.0, 0.0))
    assert differences(made_document(), after).same
    assert not compare_runs(run_of(made_document()), run_of(after), within_m=1e-5, within_rad=1.0).same


def test_other_targets_are_compared_in_the_axes_of_the_first():
    after = made_document()
    after["target"] = "rear"
    for name, entry in after["lidars"].items():
        entry["T_target_source"] = (TRUTH["rear"].inverse() @ TRUTH[name]).matrix.tolist()
    found = differences(made_document(), after)
    assert found.same
    assert (found.target, found.targets) == (TARGET, (TARGET, "rear"))


@pytest.mark.parametrize("turned", [False, True])
def test_a_lidar_that_only_one_run_placed_comes_with_its_cause(turned):
    pair = [made_document("complete"), made_document("partial")]
    found = differences(*(reversed(pair) if turned else pair))
    (change,) = found.statuses.values()
    words = ("placed", "not placed")
    assert (change.lidar, change.before, change.after) == ("rear", *(reversed(words) if turned else words))
    assert change.why == "rear is not placed: it shares too few surfaces with the others (no overlap)."
    assert not found.same


def test_a_lidar_that_neither_run_placed_comes_with_both_causes():
    before, after = made_document("partial"), made_document("partial")
    after["input"]["lidars"]["rear"]["points"] = 0
    found = differences(before, after)
    (rear,) = found.placed_by_neither.values()
    assert found.same
    assert rear.lidar == "rear"
    assert "(no overlap)" in rear.before
    assert "dead sensor" in rear.after
    assert differences(made_document("partial"), made_document()).placed_by_neither == {}


@pytest.mark.parametrize("other", ["complete", "partial"])
def test_an_uncertain_lidar_is_neither_placed_nor_missing(other):
    found = differences(made_document(other), made_document("uncertain"))
    (change,) = found.statuses.values()
    assert (change.lidar, change.after) == ("rear", "uncertain")
    cause = "rear is uncertain: sigma 30.0 mm mostly along x of top" if other == "complete" else "rear is uncertain"
    assert change.why.startswith(cause)
    assert not found.same
    assert found.placed_by_neither == {}


def test_uncertain_poses_of_both_runs_are_compared():
    found = differences(made_document("uncertain"), moved(made_document("uncertain"), "rear", (0.03, 0.0, 0.0)))
    front, rear = found.moves.values()
    assert (front.uncertain, rear.uncertain) == (False, True)
    assert rear.moved
    assert rear.sigmas == pytest.approx(0.5**0.5)
    assert found.statuses == {}


def test_the_first_stage_that_differs_is_named():
    after = made_document()
    after["stages"]["correspond"]["front left/1 <- rear"]["matches"] += 1
    after["stages"]["merge"]["step 0"]["fitness"] *= 1.5
    found = differences(made_document(), after)
    assert [*found.differences] == ["correspond", "merge"]
    (change,) = found.differences["correspond"]
    assert (change.what, change.after - change.before) == ("front left/1 <- rear.matches", 1)


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_has_figures_in_which_runs_can_differ(stage):
    before = made_document()
    name, figures = next(iter(before["stages"][stage].items()))
    for key in figures:
        changed = made_document()
        changed["stages"][stage][name][key] = altered(figures[key])
        ((step, (change,)),) = stage_differences(parsed(before), parsed(changed)).items()
        assert step == stage
        assert change.what.startswith(f"{name}.{key}")


def altered(value):
    if isinstance(value, dict):
        return {key: altered(each) for key, each in list(value.items())[:1]} | dict(list(value.items())[1:])
    if isinstance(value, list):
        return [altered(value[0]), *value[1:]]
    return "otherwise" if isinstance(value, str) else value + 1


def test_input_and_configuration_come_before_the_stages():
    after = made_document()
    after["input"]["sha256"] = "other"
    after["config"]["fine"]["max_iterations"] = 7
    after["stages"]["fine"] = {}
    assert [*differences(made_document(), after).differences] == [
        "input",
        "config",
        "fine",
    ]


def test_the_same_bytes_under_another_name_are_the_same_input():
    after = made_document()
    after["input"]["source"] = "copy.mcap"
    assert differences(made_document(), after).differences == {}


@pytest.mark.parametrize(
    ("before", "after", "differs"),
    [
        (1.0, 1.0 + 5e-7, False),
        (1.0, 1.0 + 5e-6, True),
        (1e6, 1e6 + 0.5, False),
        ([1.0, 2.0], [1.0, 2.0 + 1e-9], False),
        ([1.0, 2.0], [1.0], True),
        (None, 0.0, True),
        ("a", "a", False),
        (3, 4, True),
    ],
)
def test_figures_that_differ_by_rounding_are_equal(before, after, differs):
    assert bool(list(changes_between({"x": before}, {"x": after}))) is differs


def test_runs_without_figures_are_compared_as_far_as_that_goes():
    before = made_document()
    del before["stages"]
    found = differences(before, made_document())
    assert found.differences == {}
    assert "A has no figures per stage" in found.notes[0]


def test_run_without_a_placed_target_has_no_moves():
    after = made_document("failed")
    after["target"] = "rear"
    for entry in after["lidars"].values():
        entry |= {"placed": False, "status": "not_placed"}
    found = differences(made_document(), after)
    assert found.moves == {}
    assert "B does not place top" in found.notes[0]


def test_runs_of_different_rigs_are_refused():
    after = made_document()
    after |= {"lidars": {"other": after["lidars"]["rear"]}, "pairs": [], "target": "other"}
    with pytest.raises(InputError, match="no LiDAR in common"):
        differences(made_document(), after)


def test_the_document_is_strict_json():
    before, after = made_document("complete"), made_document("partial")
    after["lidars"]["front left/1"]["covariance"] = None
    document = differences(before, after)
    assert RunDifference.model_validate_json(document.model_dump_json()) == document
    assert document.first_difference == "fine"
    assert {*document.moves, *document.statuses} == set(LIDARS) - {TARGET}
    assert document.moves["front left/1"].sigmas is None


def test_a_turn_about_an_axis_is_told_in_degrees():
    after = made_document()
    turn = RigidTransform.from_xyz_rpy(TARGET, TARGET, (0, 0, 0), (0, 0, math.radians(2.0)))
    pose = RigidTransform(TARGET, "rear", np.array(after["lidars"]["rear"]["T_target_source"]))
    matrix = pose.matrix.copy()
    matrix[:3, :3] = turn.rotation @ pose.rotation
    after["lidars"]["rear"]["T_target_source"] = matrix.tolist()
    entry = differences(made_document(), after).moves["rear"]
    np.testing.assert_allclose(entry.rotation_deg, (0.0, 0.0, 2.0), atol=1e-9)
    assert entry.angle_deg == pytest.approx(2.0)
    assert entry.distance_m == 0.0
