# SPDX-License-Identifier: Apache-2.0
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from multilica import events
from multilica.config import STAGES, CalibrationConfig, preset, with_overrides
from multilica.orchestration.pairs import PAIR_STAGES
from multilica.pipeline import calibrate
from multilica.results.building import provenance_of, result_document
from multilica.simulate import simulate_snapshot
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.pipeline.watched import GOOD_M, GOOD_RAD, assert_true, of, only, sides, watched
from tests.selection import some_of

_SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "reference" / "result.schema.json").read_text())


@pytest.fixture(scope="module")
def complete():
    return watched(sides().snapshot, "ground.enabled=true")


@pytest.mark.slow
def test_in_a_symmetric_garage_nothing_is_placed():
    """The sides share nothing, and fit each other turned around; the top one sees that both poses are possible."""
    result = calibrate(simulate_snapshot("sides", "symmetric_garage", 3, frames=1).snapshot)
    assert result.status == "failed"
    assert result.target_reason == "most points, as no pair was accepted"
    assert all("ambiguous" in pair.verdict.codes for pair in result.pairs)


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_group_in_a_court_is_not_turned_either():
    """Two LiDARs that found each other fit the third at four poses, as each of them alone does."""
    made = simulate_snapshot("sides", "court", 3004, frames=1)
    result = calibrate(made.snapshot)
    for each in result.placements:
        if each.placed:
            assert each.T_target_source.distance_to(made.truth.between(result.target, each.lidar))[0] < GOOD_M


@pytest.mark.slow
def test_all_are_placed_within_2_cm_and_a_tenth_of_a_degree(complete):
    result, _ = complete
    assert result.status == "complete"
    assert [placement.lidar for placement in result.placements] == ["left", "right", "top"]
    assert_true(result, sides().truth)
    assert result[result.target].reason == "the target"
    assert np.array_equal(result[result.target].T_target_source.matrix, np.eye(4))


@pytest.mark.slow
def test_the_ground_gives_roll_pitch_and_height_of_the_target(complete):
    result, seen = complete
    truth = sides().truth.T_target_source[result.target]
    found = result.ground.T_base_target
    assert (found.target, found.source) == ("base", result.target)
    assert np.all(np.abs(found.rpy_deg[:2] - truth.rpy_deg[:2]) < 0.05)
    assert abs(found.xyz_m[2] - truth.xyz_m[2]) < 0.02
    assert abs(found.xyz_m[2] - truth.xyz_m[2]) < 3.0 * result.ground.sigma_z_m
    assert of(events.GroundEstimated, seen)[0].ground is result.ground


@pytest.mark.slow
def test_events_are_in_the_order_of_the_stages(complete):
    result, seen = complete
    assert isinstance(seen[0], events.CalibrationStarted)
    assert isinstance(seen[-1], events.CalibrationFinished)
    assert seen[-1].result is result
    pairs = {("left", "right"), ("left", "top"), ("right", "top")}
    assert [event.cloud.lidar for event in of(events.CloudPreprocessed, seen)] == ["left", "right", "top"]
    assert [event.features.lidar for event in of(events.FeaturesComputed, seen)] == ["left", "right", "top"]
    correspondences = [event.correspondences for event in of(events.CorrespondencesMatched, seen)]
    matched = [(each.target, each.source) for each in correspondences]
    assert {*matched} < pairs
    assert [(each.coarse.target, each.coarse.source) for each in of(events.HypothesesFound, seen)] == matched
    assert [(each.target, each.source) for each in of(events.HypothesesVerified, seen)] == matched
    assert [{*each.registration.lidars} for each in of(events.PairRegistered, seen)] == [{*pair} for pair in matched]
    assert {each.lidars for each in result.pairs} == {frozenset(pair) for pair in pairs}
    decisions = [event.decision for event in of(events.MergeStepTaken, seen)]
    assert tuple(decisions) == result.decisions
    assert decisions[-1].groups == (("left", "right", "top"),)
    assert of(events.TargetChosen, seen)[0].target == result.target
    _assert_stages_nest(seen)
    assert [event.stage for event in of(events.StageStarted, seen)] == list(STAGES)
    assert set(result.timing_s) == set(STAGES)


def _assert_stages_nest(seen):
    """Stages that run together begin and end together; only the first and last event are outside of a stage."""
    running = []
    for event in seen[1:-1]:
        if isinstance(event, events.StageStarted):
            assert {*running} < {*PAIR_STAGES}
            running.append(event.stage)
            assert len(running) == 1 or event.stage in PAIR_STAGES
        elif isinstance(event, events.StageFinished):
            assert running.pop(0) == event.stage
            assert event.elapsed_s >= 0.0
        else:
            assert running, event
    assert running == []


@pytest.mark.slow
def test_the_result_document_follows_its_schema(complete):
    result, _ = complete
    document = result_document(
        result, with_overrides(CalibrationConfig(), ["ground.enabled=true"]), provenance_of(sides().snapshot)
    )
    jsonschema.validate(json.loads(document.model_dump_json()), _SCHEMA)
    assert document.status == "complete"
    assert np.array_equal(document.lidars["left"].T_target_source, result["left"].T_target_source.matrix)


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("until", some_of(STAGES, 4))
def test_stopping_after_any_stage_gives_a_result(until):
    snapshot = only(sides().snapshot, "left", "top", every=2)
    result, seen = watched(snapshot, f"until={until}", "ground.enabled=true", "fine.max_finalists=2")
    _assert_stages_nest(seen)
    done = list(STAGES[: STAGES.index(until) + 1])
    assert [event.stage for event in of(events.StageFinished, seen)] == done
    assert seen[-1].result is result
    if "merge" in done:
        assert result.status == "complete"
    else:
        assert result.status == "failed"
        assert result["left"].placed
        assert not result["top"].placed
        assert result["top"].reason == f"the run stopped after stage {until} (--until)"
        assert result.decisions == ()
    document = result_document(result, CalibrationConfig(), provenance_of(snapshot))
    jsonschema.validate(json.loads(document.model_dump_json()), _SCHEMA)


@pytest.mark.slow
def test_two_runs_give_the_same_bits():
    snapshot = only(sides().snapshot, "left", "top", every=2)
    first, second = (watched(snapshot, "fine.max_finalists=2")[0] for _ in range(2))
    assert first.status == "complete"
    for name in ("left", "top"):
        assert first[name].T_target_source.matrix.tobytes() == second[name].T_target_source.matrix.tobytes()
        assert first[name].fitness == second[name].fitness
    for one, other in zip(first.pairs, second.pairs, strict=True):
        assert one.hessian.tobytes() == other.hessian.tobytes()
        assert one.evidence == other.evidence


@pytest.mark.slow
@pytest.mark.in_turn
def test_beside_a_lidar_without_returns_the_others_are_placed():
    result, _ = watched(sides("dead:left").snapshot)
    assert result.status == "partial"
    assert result["left"].reason == "it has no returns in range"
    assert result["left"].T_target_source is None
    metres, radians = result["right"].T_target_source.distance_to(sides().truth.between(result.target, "right"))
    assert metres < GOOD_M
    assert radians < GOOD_RAD


@pytest.mark.slow
@pytest.mark.in_turn
def test_lidars_that_share_nothing_are_not_placed():
    simulation = simulate_snapshot("blind", "garage", 101, frames=1)
    result, seen = watched(only(simulation.snapshot, "front_left", "rear", every=2), "target=front_left")
    assert result.status == "failed"
    assert not result["rear"].placed
    assert "front_left" in result["rear"].reason
    assert result.decisions[-1].chosen is None
    assert of(events.TargetChosen, seen)[0].reason == "set by --target"


@pytest.mark.slow
def test_returns_beyond_the_features_range_are_no_crash():
    near = sides().snapshot["top"].scans[0].points_m[::4]
    directions = near / np.linalg.norm(near, axis=1, keepdims=True)
    snapshot = Snapshot((LidarScans("far", (Scan(directions * 60.0),)), LidarScans("top", (Scan(near),))))
    result, _ = watched(snapshot, "target=top")
    assert result.status == "failed"
    assert result["far"].reason == "no pose was found against any other LiDAR"


@pytest.mark.slow
def test_the_paper_preset_runs():
    snapshot = only(sides().snapshot, "right", "top", every=2)
    result, seen = watched(snapshot, base=preset("paper"))
    assert [pair.engine for pair in result.pairs] == ["open3d"]
    assert of(events.HypothesesVerified, seen) == []
    assert all(pair.registrations == () for pair in result.pairs)
    verdict = result.pairs[0].verdict
    assert verdict.accepted == (result.pairs[0].fitness > 0.2)
    assert result.status == ("complete" if verdict.accepted else "failed")


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "scene", "seed", "flow", "frames"),
    [
        pytest.param("edgar", "motorway", 902, "queue", 1, marks=pytest.mark.nightly, id="queue"),
        pytest.param("edgar", "bridge", 902, "both_ways", 1, id="a merge of groups"),
        pytest.param("sides", "bridge", 905, "one_way", 1, marks=pytest.mark.nightly, id="a car beside a railing"),
        pytest.param("sides", "motorway", 3007, "queue", 10, id="what is left of cars that crept"),
    ],
)
def test_no_pose_follows_cars_that_moved(rig, scene, seed, flow, frames):
    """Poses follow cars that moved between the scans by up to 0.36 m, with a fit that trusts them."""
    simulated = simulate_snapshot(rig, scene, seed, frames=frames, disturbances=(f"traffic:{flow}",))
    result = calibrate(simulated.snapshot)
    posed = [each for each in result.placements if each.covariance is not None]
    assert posed
    for each in posed:
        off = each.T_target_source.offset_from(simulated.truth.between(result.target, each.lidar))
        assert off @ np.linalg.solve(each.covariance, off) < 22.5
        assert each.uncertain or np.linalg.norm(off[3:]) < 0.02
        assert each.uncertain or not each.held_by_movable


@pytest.mark.slow
@pytest.mark.in_turn
def test_poses_have_a_sigma_without_a_joint_refinement():
    snapshot, names = sides().snapshot, ("left", "right")
    whole, stopped, unrefined = (
        watched(snapshot, *each)[0] for each in ((), ("until=merge",), ("refine.enabled=false",))
    )
    for result in (stopped, unrefined):
        assert result.refinement is None
        for name in names:
            assert result[name].sigma_xyz_m == pytest.approx(whole[name].sigma_xyz_m, rel=0.2)
    imprecise, _ = watched(snapshot, "until=merge", "acceptance.max_sigma_m=0.0001")
    assert {imprecise[name].status for name in names} == {"uncertain"}
