# SPDX-License-Identifier: Apache-2.0
"""One rig out of made registrations of several snapshots whose truth is known."""

import re
import sys
from dataclasses import replace
from itertools import combinations, permutations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.diagnosis import explain
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun, estimate, join, pose_conflicts, require_joinable, shown_snapshot
from multilica.multi_snapshot.estimate import Estimate
from multilica.multi_snapshot.join import choose_target
from multilica.multi_snapshot.pose_conflicts import _vote, resolve_conflicts
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.results import CalibrationResult, LidarPlacement, PairRegistration, PoseConflict, TimeLimit
from multilica.results.building import provenance_of, result_document
from multilica.snapshot import Snapshot
from multilica.stages.refine import refine

_SIGMA = np.array([1e-4] * 3 + [2e-3] * 3)
_TRUTH = {
    name: RigidTransform.from_xyz_rpy("T", name, [index, -0.5 * index, 0.2 * (index > 0)], [0.1 * index, 0.0, -index])
    for index, name in enumerate("TABC")
}
_ALL = tuple(combinations("ABCT", 2))
_TURNED = RigidTransform.from_xyz_rpy("A", "A", [0.0, 0.0, 0.0], [0.0, 0.0, np.deg2rad(3.0)])


def _nudged(pose, offset):
    rotation = Rotation.from_rotvec(offset[:3]).as_matrix() @ pose.rotation
    return RigidTransform.from_rotation_translation(pose.target, pose.source, rotation, pose.xyz_m + offset[3:])


def _run(name, seed, pairs=_ALL, *, tampered="", noise=1.0, claimed=1.0, target="T", placed="", status="placed"):
    """A snapshot that measures those pairs; the points of one LiDAR may have been turned by 3 degrees."""
    rng = np.random.default_rng(seed)
    poses = {lidar: pose @ _frame(_TURNED, lidar) if lidar == tampered else pose for lidar, pose in _TRUTH.items()}
    registrations = tuple(
        PairRegistration(
            target=one,
            source=other,
            T_target_source=_nudged(poses[one].inverse() @ poses[other], noise * _SIGMA * rng.normal(size=6)),
            fitness=0.9 if "T" in (one, other) else 0.5,
            rmse_m=0.05,
            inliers=1000,
            converged=True,
            iterations=5,
            engine="test",
            information=np.diag((claimed * _SIGMA) ** -2.0),
        )
        for one, other in pairs
    )
    placements = tuple(
        LidarPlacement(lidar, "alone", status, _TRUTH[lidar])
        if lidar == placed
        else LidarPlacement(lidar, "nothing in common")
        for lidar in "ABCT"
    )
    return SnapshotRun(
        name, CalibrationResult(target, "", placements, trusted=registrations), f"{name}.mcap", f"{seed:064x}"
    )


def _frame(transform, lidar):
    return RigidTransform(lidar, lidar, transform.matrix)


def _refused(name):
    return SnapshotRun(name, None, f"{name}.mcap", refusal=f"{name}: the vehicle moves.")


def _joined(*runs):
    return join(runs, CalibrationConfig(target="T"))


def _errors_m(result):
    return [
        place.T_target_source.distance_to(_TRUTH[place.lidar])[0] for place in result.placements if place.lidar != "T"
    ]


def _outliers(result):
    return {report.name: [*report.outliers] for report in result.snapshots}


@pytest.mark.slow
@pytest.mark.in_turn
def test_more_snapshots_place_the_rig_better():
    """Sigma falls by less than the root of three: a tenth of the errors is the same in all snapshots."""
    alone, joint, sigma = [], [], []
    for seed in range(0, 21, 3):
        runs = [_run(f"s{k}", seed + k) for k in range(3)]
        one, all_three = _joined(*runs[:1]), _joined(*runs)
        assert (one.status, all_three.status) == ("complete", "complete")
        assert all(all_three[name].spread.snapshots == 3 for name in "ABC")
        alone += _errors_m(one)
        joint += _errors_m(all_three)
        sigma += [np.max(all_three[name].sigma_xyz_m) / np.max(one[name].sigma_xyz_m) for name in "ABC"]
    assert np.mean(joint) < 0.7 * np.mean(alone)
    assert 3.0**-0.5 < np.median(sigma) < 0.95


def test_the_spread_is_what_the_snapshots_scatter_by():
    result = _joined(*(_run(f"s{k}", k, [("T", "A")]) for k in range(30)))
    spread = result["A"].spread
    assert spread.snapshots == 30
    assert spread.xyz_m == pytest.approx([2e-3] * 3, rel=0.4)
    assert np.deg2rad(spread.rotation_deg) == pytest.approx([1e-4] * 3, rel=0.4)
    assert _joined(_run("s", 0))["A"].spread.xyz_m is None


@pytest.mark.slow
@pytest.mark.parametrize(("claimed", "origin"), [(0.25, "snapshots"), (4.0, "residuals")])
def test_sigma_is_widened_to_the_scatter_and_never_narrowed(claimed, origin):
    normalised = []
    for seed in range(0, 48, 6):
        result = _joined(*(_run(f"s{k}", seed + k, [("T", "A")], claimed=claimed) for k in range(6)))
        assert result["A"].sigma_from == origin
        error = result["A"].T_target_source.offset_from(_TRUTH["A"])
        normalised += list(np.abs(error) / np.sqrt(np.diag(result["A"].covariance)))
    # Errors average out over six snapshots; sigma allows for a tenth that does not.
    expected = 0.674 / max(1.0, claimed) / np.sqrt(1.0 + 0.1 * 5.0)
    assert 0.6 * expected < np.median(normalised) < 1.5 * expected


def test_a_vague_snapshot_may_scatter_as_far_as_it_says():
    vague = _run("vague", 9, [("T", "A")], noise=20.0, claimed=20.0)
    sure = [_run(f"s{k}", k, [("T", "A")]) for k in range(2)]
    result = _joined(*sure, vague)
    assert np.max(result["A"].sigma_xyz_m) < 2.0 * np.max(_joined(*sure)["A"].sigma_xyz_m)
    assert result["A"].T_target_source.distance_to(_TRUTH["A"])[0] < 5e-3


def test_one_of_three_that_contradicts_is_named_and_left_out():
    result = _joined(_run("a", 1), _run("b", 2, tampered="A"), _run("c", 3))
    assert result.status == "complete"
    assert max(_errors_m(result)) < 6e-3
    assert _outliers(result) == {"a": [], "b": ["A"], "c": []}
    (outlier,) = (each for each in result.snapshots[1].deviations if each.outlier)
    assert outlier.angle_deg == pytest.approx(3.0, abs=0.05)
    assert [result[name].spread.snapshots for name in "ABC"] == [2, 3, 3]
    assert [pair.snapshot for pair in result.refinement.pairs].count("b") == 3


def test_a_target_that_contradicts_is_named_as_the_outlier():
    result = _joined(_run("a", 1), _run("b", 2, tampered="T"), _run("c", 3))
    assert result.status == "complete"
    assert max(_errors_m(result)) < 6e-3
    assert _outliers(result) == {"a": [], "b": ["T"], "c": []}


def test_one_against_one_is_not_placed_and_both_are_named():
    result = _joined(_run("monday", 1), _run("tuesday", 2, tampered="A"))
    assert result.status == "partial"
    assert [place.lidar for place in result.placements if not place.placed] == ["A"]
    assert "monday" in result["A"].reason
    assert "tuesday" in result["A"].reason
    assert re.search(r"0\.06\d m and (2\.99|3\.0\d) deg apart", result["A"].reason)
    assert _outliers(result) == {"monday": [], "tuesday": []}
    assert [report.disputed for report in result.snapshots] == [("A",), ("A",)]


def test_two_against_two_is_no_majority():
    runs = [_run("a", 1), _run("b", 2, tampered="A"), _run("c", 3), _run("d", 4, tampered="A")]
    result = _joined(*runs)
    assert not result["A"].placed
    assert result["B"].placed


def test_a_snapshot_too_vague_to_contradict_makes_no_majority():
    vague = _run("vague", 5, [("T", "A")], claimed=500.0)
    pairs = [("T", "A")]
    result = _joined(_run("a", 1, pairs), _run("b", 2, pairs, tampered="A"), vague)
    assert result["A"].spread.snapshots == 1
    assert np.max(result["A"].sigma_xyz_m) > 0.5


def test_the_vote_does_not_depend_on_the_order():
    def measured(x_m, sigma_m):
        pose = RigidTransform.from_xyz_rpy("A", "T", [x_m, 0.0, 0.0], [0.0, 0.0, 0.0])
        return Estimate(pose, np.diag([1e-8] * 3 + [sigma_m**2, 1e-6, 1e-6]))

    found = {"a": (0.409, 0.003), "b": (-0.002, 0.003), "c": (0.298, 0.03), "d": (0.001, 0.003), "e": (0.005, 0.003)}
    voters = {name: measured(*each) for name, each in found.items()}
    votes = {
        frozenset((each.snapshot, each.outvoted) for each in _vote(("A", "T"), dict(order), CalibrationConfig()))
        for order in permutations(voters.items())
    }
    assert votes == {frozenset((name, True) for name in "ac")}


def test_several_sets_of_as_many_snapshots_are_no_majority(monkeypatch):
    against = {frozenset(each) for each in ("ab", "cd", "de")}
    monkeypatch.setattr(pose_conflicts, "_contradict", lambda one, other, _: frozenset((one.of, other.of)) in against)
    pose = RigidTransform.identity("A", "T")
    voters = {name: SimpleNamespace(of=name, pose=pose) for name in "abcde"}
    found = [*_vote(("A", "T"), voters, CalibrationConfig())]
    assert [(each.snapshot, each.outvoted) for each in found] == [(name, False) for name in "abcde"]


def test_disagreement_within_the_limits_is_no_outlier():
    shifted = np.array([0.0, 0.0, 0.0, 0.04, 0.0, 0.0])
    run = _run("far", 2)
    moved = tuple(
        PairRegistration(
            pair.target,
            pair.source,
            _nudged(pair.T_target_source, shifted * ("A" in (pair.target, pair.source))),
            *(pair.fitness, pair.rmse_m, pair.inliers, pair.converged, pair.iterations, pair.engine),
            information=pair.information,
        )
        for pair in run.result.trusted
    )
    far = SnapshotRun("far", CalibrationResult("T", "", run.result.placements, trusted=moved))
    result = _joined(_run("a", 1), far, _run("b", 3))
    assert _outliers(result) == {"a": [], "far": [], "b": []}
    assert result["A"].sigma_from == "snapshots"
    first, off, _ = result.snapshots
    assert {each.lidar: each.contradicts for each in off.deviations} == {"A": ("a", "b"), "B": (), "C": ()}
    assert [each.contradicts for each in first.contradicting] == [("far",)]
    assert "differs from a and b on A by more than their sigmas allow" in off.text


def test_the_probability_is_that_of_the_least_alike_snapshot():
    runs = [_run(f"s{k}", k, [("T", "A")]) for k in range(20)]
    reports = _joined(*runs).snapshots
    probabilities = [each.probability for report in reports for each in report.deviations]
    assert len(probabilities) == 20
    assert 0.01 < np.median(probabilities) < 0.2  # the least of 19, which are uniform from 0 to 1
    assert _joined(runs[0]).snapshots[0].deviations[0].probability is None


def test_contradiction_through_a_third_lidar_is_dropped():
    """In `b`, A is connected to T only through C, which no other snapshot has."""
    detour = _run("b", 2, [("T", "C"), ("C", "A")], tampered="A", placed="C")
    result = _joined(_run("a", 1, [("T", "A")]), detour, _run("c", 3, [("T", "A")]))
    assert result["A"].spread.snapshots == 2
    assert result["A"].T_target_source.distance_to(_TRUTH["A"])[0] < 6e-3
    assert not result["C"].placed
    assert "b: connected through pairs that contradict other snapshots on A" in result["C"].reason
    assert _outliers(result)["b"] == ["A"]


def test_what_one_snapshot_lacks_another_places():
    result = _joined(_run("a", 1, [("T", "A")]), _run("b", 2, [("A", "B")]), _run("c", 3, [("T", "A"), ("B", "C")]))
    assert result.status == "complete"
    assert max(_errors_m(result)) < 0.015
    assert [deviation.lidar for deviation in result.snapshots[0].deviations] == ["A"]
    assert result["B"].spread.snapshots == 0
    assert result["B"].reason == "placed by pairs of several snapshots, though none of 3 snapshots places it alone"


def test_refused_snapshots_are_left_out_and_named():
    result = _joined(_refused("a"), _run("b", 2))
    assert result.status == "complete"
    assert result.snapshots[0].refusal == "a: the vehicle moves."
    assert shown_snapshot(result) == "b"
    with pytest.raises(UnfitSnapshotError, match=r"None of 2 snapshots can be used: a: the vehicle moves; c: the veh"):
        join([_refused("a"), _refused("c")])


@pytest.mark.parametrize("status", ["placed", "uncertain"])
def test_lidar_not_connected_to_the_target_names_its_root(status):
    apart = _run("a", 1, [("B", "C")], target="B", placed="C", status=status)
    result = _joined(apart, _run("b", 2, [("T", "A")]))
    assert (
        result["C"].reason == f"a: {status} relative to B, but no accepted pair connects it to T. b: nothing in common"
    )


def test_a_joint_sigma_above_the_limit_is_uncertain():
    runs = [_run(name, seed, [("T", "A"), ("T", "B"), ("T", "C")]) for seed, name in enumerate("ab")]
    strict = join(runs, CalibrationConfig(target="T", acceptance={"max_sigma_m": 1e-3}))
    assert strict.status == "partial"
    assert [strict[name].status for name in "ABCT"] == ["uncertain"] * 3 + ["placed"]
    assert re.fullmatch(r"sigma \d+ mm, limit 1 mm", strict["A"].reason)
    lenient = join(runs, CalibrationConfig(target="T", acceptance={"max_sigma_m": 1e-2}))
    assert lenient.status == "complete"
    np.testing.assert_array_equal(strict["A"].T_target_source.matrix, lenient["A"].T_target_source.matrix)
    np.testing.assert_array_equal(strict["A"].covariance, lenient["A"].covariance)


def test_nothing_in_common_says_so_per_snapshot():
    result = _joined(_run("a", 1, []), _run("b", 2, [("T", "A")]))
    assert result["B"].reason == "a: nothing in common. b: nothing in common"


def test_target_has_most_overlap_in_most_snapshots():
    result = join([_run("a", 1, [("A", "B"), ("A", "C")]), _run("b", 2), _run("c", 3, [("T", "A"), ("T", "C")])])
    assert result.target == "T"
    assert result.target_reason == "most overlap in 2 of 3 snapshots"
    assert join([_run("a", 1)], CalibrationConfig(target="B")).target == "B"
    with pytest.raises(UnknownNameError, match="no LiDAR 'X'"):
        join([_run("a", 1)], CalibrationConfig(target="X"))


def test_disputed_lidar_does_not_become_the_target():
    result = join([_run("a", 1), _run("b", 2, tampered="T")])
    assert result.target != "T"
    assert [place.lidar for place in result.placements if not place.placed] == ["T"]


@pytest.mark.slow
def test_the_order_of_snapshots_does_not_matter():
    runs = [_run("a", 1), _run("b", 2, tampered="A"), _run("c", 3)]
    one, other = _joined(*runs), _joined(*runs[::-1])
    assert _outliers(one) == _outliers(other)
    for name in "ABC":
        assert one[name].T_target_source.matrix == pytest.approx(other[name].T_target_source.matrix, abs=1e-9)


@pytest.mark.parametrize(
    ("config", "named"),
    [(preset("paper"), "preset paper"), (with_overrides(CalibrationConfig(), ["until=fine"]), "--until fine")],
)
def test_what_measures_no_uncertainty_cannot_be_joined(config, named):
    with pytest.raises(UsageError, match=named):
        require_joinable(config)


def _edge(target, source, fitness):
    pose = RigidTransform.identity(target, source)
    return PairRegistration(
        target, source, pose, fitness, rmse_m=0.1, inliers=9, converged=True, iterations=1, engine=""
    )


def test_rounding_does_not_break_a_tie():
    """0.3 + 0.2 + 0.1 and 0.1 + 0.2 + 0.3 differ in the last bit."""
    names, fitness = "XYZ", (0.3, 0.2, 0.1)
    edges = tuple(_edge("A", name, each) for name, each in zip(names, fitness, strict=True))
    edges += tuple(_edge("B", name, each) for name, each in zip(names, reversed(fitness), strict=True))
    target, reason = choose_target({"only": edges}, ["A", "B", *names], "")
    assert target == "A"
    assert reason == "most overlap in 1 of 1 snapshots"


def _cut(run, *not_reached):
    return replace(run, result=replace(run.result, time_limit=TimeLimit(5.0, not_reached)))


def test_a_joint_result_has_the_time_limit_of_its_snapshots():
    assert _joined(_run("one", 1), _run("two", 2)).time_limit is None
    few = tuple(pair for pair in _ALL if "C" not in pair)
    one = _cut(_run("one", 1, few), ("A", "B"), ("C", "T"))
    other = _cut(_run("two", 2, few), ("A", "C"))
    result = _joined(one, other, _run("three", 3, few), _refused("four"))
    assert result.time_limit == TimeLimit(5.0, (("A", "C"), ("C", "T")))  # A and B have poses
    explanation = explain(result_document(result, CalibrationConfig(), provenance_of(Snapshot(()))))
    assert {missing.lidar: missing.cause for missing in explanation.missing} == {"C": "out_of_time"}
    assert "A - C, C - T" in " ".join(explanation.warnings)
    assert _joined(_cut(_run("one", 1), ("C", "T")), _run("two", 2)).time_limit == TimeLimit(5.0, ())


@pytest.mark.parametrize(("tampered", "roots"), [("", {"A"}), ("B", {"A", "B", "C", "T"})])
def test_snapshots_that_agree_are_compared_without_covariances(monkeypatch, tampered, roots):
    asked = []

    def refined(root, *rest):
        asked.append(root)
        return refine(root, *rest)

    monkeypatch.setattr(estimate, "refine", refined)
    pairs = {run.name: run.result.trusted for run in (_run("a", 1), _run("b", 2), _run("c", 3, tampered=tampered))}
    _, conflicts = resolve_conflicts(pairs, CalibrationConfig())
    assert {*asked} == roots
    assert bool(conflicts) is bool(tampered)


@pytest.mark.parametrize(("angle_deg", "alike"), [(20.0, False), (40.0, True)])
def test_snapshots_tell_a_knock_from_a_place_that_looks_alike(monkeypatch, angle_deg, alike):
    """As links do: docs/drives.md tells the limits."""
    module, asked = sys.modules["multilica.multi_snapshot.join"], []
    conflict = PoseConflict("b", ("A", "B"), ("a",), 0.1, angle_deg, outvoted=False)
    monkeypatch.setattr(module, "resolve_conflicts", lambda pairs, _: (pairs, (conflict,)))

    def refined(*arguments, looks_alike, **rest):
        asked.append(looks_alike)
        return refine_linked(*arguments, looks_alike=looks_alike, **rest)

    monkeypatch.setattr(module, "refine_linked", refined)
    join([_run("a", 1), _run("b", 2)])
    assert asked == [alike]
