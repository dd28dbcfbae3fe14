# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from multilica import events
from multilica.config import STAGES, CalibrationConfig, preset, with_overrides
from multilica.pipeline import calibrate
from multilica.results import Reason, Verdict
from multilica.simulate import simulate_snapshot
from multilica.sinks.files.provenance import provenance_of
from multilica.sinks.files.result_document import result_document
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.steps import pairs as pair_steps

_SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "result.schema.json").read_text())
_GOOD_M, _GOOD_RAD = 0.02, np.deg2rad(0.1)


@cache
def _sides(*disturbances):
    return simulate_snapshot("sides", "garage", 101, frames=1, disturbances=disturbances)


def _only(snapshot, *names, every=1):
    """Fewer LiDARs with fewer returns, for tests that look at the order and not at the pose."""
    scans = {name: snapshot[name].scans[0].points_m[::every] for name in names}
    return Snapshot(tuple(LidarScans(name, (Scan(points),)) for name, points in scans.items()))


def _watched(snapshot, *settings, base=None):
    seen = []
    result = calibrate(snapshot, with_overrides(base or CalibrationConfig(), settings), seen.append)
    return result, seen


@pytest.fixture(scope="module")
def complete():
    return _watched(_sides().snapshot, "ground.enabled=true")


def _of(kind, seen):
    return [event for event in seen if isinstance(event, kind)]


def _assert_true(result, truth):
    for placement in result.placements:
        metres, radians = placement.T_target_source.distance_to(truth.between(result.target, placement.lidar))
        assert metres < _GOOD_M, (placement.lidar, metres)
        assert radians < _GOOD_RAD, (placement.lidar, radians)


def test_a_pair_that_the_search_missed_is_registered_as_a_loop(monkeypatch):
    find = pair_steps.find_hypotheses

    def without_left_and_top(matches, *rest):
        found = find(matches, *rest)
        missed = {matches.target, matches.source} == {"left", "top"}
        return replace(found, hypotheses=()) if missed else found

    monkeypatch.setattr(pair_steps, "find_hypotheses", without_left_and_top)
    result, _ = _watched(_sides().snapshot)
    assert {(pair.target, pair.source) for pair in result.refinement.pairs} >= {("top", "left")}
    assert len(result.refinement.pairs) == 3
    _assert_true(result, _sides().truth)


@pytest.mark.parametrize("further", [False, True])
def test_unconnected_lidars_are_searched_again(monkeypatch, further):
    find = pair_steps.find_hypotheses
    calls = []

    def without_right_at_first(matches, *rest):
        calls.append((matches.target, matches.source))
        found = find(matches, *rest)
        missed = "right" in calls[-1] and len(calls) <= 3
        return replace(found, hypotheses=found.hypotheses[-1:]) if missed else found

    monkeypatch.setattr(pair_steps, "find_hypotheses", without_right_at_first)
    result, seen = _watched(_sides().snapshot, f"features.further_voxel_sizes_m={[0.3] if further else []}")
    widened = _of(events.SearchWidened, seen)
    if not further:
        assert widened == []
        assert not result["right"].placed
        return
    assert [(each.voxel_size_m, each.pairs) for each in widened] == [(0.3, (("left", "right"), ("right", "top")))]
    assert calls[3:] == [("left", "right"), ("right", "top")]
    _assert_true(result, _sides().truth)
    found = [event.coarse for event in _of(events.HypothesesFound, seen)]
    assert len(found[-1].hypotheses) > 1


@pytest.mark.parametrize(
    ("codes", "searched"),
    [
        (("not_observable",), False),
        (("ambiguous", "not_observable"), False),
        (("ambiguous",), True),
        (("empty_space_violated", "not_observable"), True),
    ],
)
def test_an_unconstrained_pair_is_not_searched_again(monkeypatch, codes, searched):
    verdict = Verdict("undecided", tuple(Reason(code, 0.0, 1.0, "made") for code in codes))
    monkeypatch.setattr(pair_steps, "accept", lambda *_: verdict)
    _, seen = _watched(_only(_sides().snapshot, "left", "top", every=5), "until=fine")
    assert bool(_of(events.SearchWidened, seen)) == searched


def test_a_doubted_pair_is_not_searched_again(monkeypatch):
    doubtful = Verdict("undecided", (Reason("ambiguous", 0.0, 1.0, "made"),))

    def doubt(pairs, *_):
        return [replace(pair, verdict=doubtful) if pair.verdict.accepted else pair for pair in pairs]

    monkeypatch.setattr(pair_steps, "check_scene_symmetry", doubt)
    result, seen = _watched(_only(_sides().snapshot, "left", "top", every=2), "until=fine")
    assert [pair.verdict for pair in result.pairs] == [doubtful]
    assert _of(events.SearchWidened, seen) == []


@pytest.mark.parametrize(("code", "placed"), [("not_observable", True), ("ambiguous", False)])
def test_an_accepted_pair_constrains_the_registration_of_groups(monkeypatch, code, placed):
    accept = pair_steps.accept
    doubt = Verdict("undecided", (Reason(code, 0.0, 1.0, "made"),))

    def doubtful_in_groups(registrations, *limits):
        return doubt if registrations[0].hypothesis == -1 else accept(registrations, *limits)

    monkeypatch.setattr(pair_steps, "accept", doubtful_in_groups)
    result, _ = _watched(_sides().snapshot, "acceptance.firm_eigenvalue=1e6")
    assert (result.status == "complete") is placed
    if placed:
        _assert_true(result, _sides().truth)


def test_in_a_symmetric_garage_nothing_is_placed():
    """The sides share nothing, and fit each other turned around; the top one sees that both poses are possible."""
    result = calibrate(simulate_snapshot("sides", "symmetric_garage", 3, frames=1).snapshot)
    assert result.status == "failed"
    assert result.target_reason == "most points; no pair was accepted"
    assert all("ambiguous" in pair.verdict.codes for pair in result.pairs)


def test_all_are_placed_within_2_cm_and_a_tenth_of_a_degree(complete):
    result, _ = complete
    assert result.status == "complete"
    assert [placement.lidar for placement in result.placements] == ["left", "right", "top"]
    _assert_true(result, _sides().truth)
    assert result[result.target].reason == "the target"
    assert np.array_equal(result[result.target].T_target_source.matrix, np.eye(4))


def test_the_ground_gives_roll_pitch_and_height_of_the_target(complete):
    result, seen = complete
    truth = _sides().truth.T_target_source[result.target]
    found = result.ground.T_base_target
    assert (found.target, found.source) == ("base", result.target)
    assert np.all(np.abs(found.rpy_deg[:2] - truth.rpy_deg[:2]) < 1.0)
    assert abs(found.xyz_m[2] - truth.xyz_m[2]) < 0.05
    assert _of(events.GroundEstimated, seen)[0].ground is result.ground


def test_events_are_in_the_order_of_the_stages(complete):
    result, seen = complete
    assert isinstance(seen[0], events.CalibrationStarted)
    assert isinstance(seen[-1], events.CalibrationFinished)
    assert seen[-1].result is result
    pairs = [("left", "right"), ("left", "top"), ("right", "top")]
    assert [event.cloud.lidar for event in _of(events.CloudPreprocessed, seen)] == ["left", "right", "top"]
    assert [event.features.lidar for event in _of(events.FeaturesComputed, seen)] == ["left", "right", "top"]
    matched = [event.correspondences for event in _of(events.CorrespondencesMatched, seen)]
    assert [(each.target, each.source) for each in matched] == pairs
    assert [(each.coarse.target, each.coarse.source) for each in _of(events.HypothesesFound, seen)] == pairs
    assert [(each.target, each.source) for each in _of(events.HypothesesVerified, seen)] == pairs
    assert {frozenset((each.target, each.source)) for each in result.pairs} == {frozenset(pair) for pair in pairs}
    decisions = [event.decision for event in _of(events.MergeStepTaken, seen)]
    assert tuple(decisions) == result.decisions
    assert decisions[-1].groups == (("left", "right", "top"),)
    assert _of(events.TargetChosen, seen)[0].target == result.target
    _assert_stages_nest(seen)
    assert [event.stage for event in _of(events.StageStarted, seen)] == list(STAGES)
    assert set(result.timing_s) == set(STAGES)


def _assert_stages_nest(seen):
    """Each stage ends before the next one begins; only the first and last event are outside of a stage."""
    running = None
    for event in seen[1:-1]:
        if isinstance(event, events.StageStarted):
            assert running is None
            running = event.stage
        elif isinstance(event, events.StageFinished):
            assert running == event.stage
            assert event.elapsed_s >= 0.0
            running = None
        else:
            assert running is not None, event
    assert running is None


def test_the_result_document_follows_its_schema(complete):
    result, _ = complete
    document = result_document(
        result, with_overrides(CalibrationConfig(), ["ground.enabled=true"]), provenance_of(_sides().snapshot)
    )
    jsonschema.validate(json.loads(document.model_dump_json()), _SCHEMA)
    assert document.status == "complete"
    assert np.array_equal(document.lidars["left"].T_target_source, result["left"].T_target_source.matrix)


@pytest.mark.parametrize("until", STAGES)
def test_stopping_after_any_stage_gives_a_result(until):
    snapshot = _only(_sides().snapshot, "left", "top", every=2)
    result, seen = _watched(snapshot, f"until={until}", "ground.enabled=true", "fine.max_finalists=2")
    _assert_stages_nest(seen)
    done = list(STAGES[: STAGES.index(until) + 1])
    assert [event.stage for event in _of(events.StageFinished, seen)] == done
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


def test_one_thread_gives_the_same_bits():
    snapshot = _only(_sides().snapshot, "left", "top", every=2)
    first, second = (_watched(snapshot, "fine.max_finalists=2")[0] for _ in range(2))
    assert first.status == "complete"
    for name in ("left", "top"):
        assert first[name].T_target_source.matrix.tobytes() == second[name].T_target_source.matrix.tobytes()
        assert first[name].fitness == second[name].fitness
    for one, other in zip(first.pairs, second.pairs, strict=True):
        assert one.hessian.tobytes() == other.hessian.tobytes()
        assert one.evidence == other.evidence


def test_beside_a_lidar_without_returns_the_others_are_placed():
    result, _ = _watched(_sides("dead:left").snapshot)
    assert result.status == "partial"
    assert result["left"].reason == "it has no returns in range"
    assert result["left"].T_target_source is None
    metres, radians = result["right"].T_target_source.distance_to(_sides().truth.between(result.target, "right"))
    assert metres < _GOOD_M
    assert radians < _GOOD_RAD


def test_lidars_that_share_nothing_are_not_placed():
    simulation = simulate_snapshot("blind", "garage", 101, frames=1)
    result, seen = _watched(_only(simulation.snapshot, "front_left", "rear", every=2), "target=front_left")
    assert result.status == "failed"
    assert not result["rear"].placed
    assert "front_left" in result["rear"].reason
    assert result.decisions[-1].chosen is None
    assert _of(events.TargetChosen, seen)[0].reason == "set by --target"


def test_returns_beyond_the_features_range_are_no_crash():
    near = _sides().snapshot["top"].scans[0].points_m[::4]
    directions = near / np.linalg.norm(near, axis=1, keepdims=True)
    snapshot = Snapshot((LidarScans("far", (Scan(directions * 60.0),)), LidarScans("top", (Scan(near),))))
    result, _ = _watched(snapshot, "target=top")
    assert result.status == "failed"
    assert result["far"].reason == "no pose was found against any other LiDAR"


def test_the_paper_preset_runs():
    snapshot = _only(_sides().snapshot, "right", "top", every=2)
    result, seen = _watched(snapshot, base=preset("paper"))
    assert [pair.engine for pair in result.pairs] == ["open3d"]
    assert _of(events.HypothesesVerified, seen) == []
    assert all(pair.registrations == () for pair in result.pairs)
    verdict = result.pairs[0].verdict
    assert verdict.accepted == (result.pairs[0].fitness >= 0.2)
    assert result.status == ("complete" if verdict.accepted else "failed")
