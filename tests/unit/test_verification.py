# SPDX-License-Identifier: Apache-2.0
"""A snapshot beside known poses, of which one is far off and one is missing."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from multilica import read_extrinsics, read_snapshot, verification
from multilica.config import CalibrationConfig, with_overrides
from multilica.errors import UnfitSnapshotError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.results import CalibrationResult, TimeLimit
from multilica.simulate import simulate_snapshot
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.verification import _trusting, register_from_known
from multilica_cli.commands.calibrate import find_sample
from tests.unit import made_pairs

MOVED, MISSING = "left", "rear"


@pytest.fixture(scope="module")
def truth() -> Extrinsics:
    return read_extrinsics(find_sample().truth)


@pytest.fixture(scope="module")
def found(truth: Extrinsics) -> CalibrationResult:
    poses = {name: pose for name, pose in truth.T_target_source.items() if name != MISSING}
    moved = RigidTransform.from_xyz_rpy(truth.target, truth.target, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    known = Extrinsics(truth.target, {**poses, MOVED: moved @ poses[MOVED]})
    return register_from_known(read_snapshot(find_sample().recording), known)


@pytest.mark.slow
def test_lidars_at_their_known_poses_are_found(found: CalibrationResult, truth: Extrinsics) -> None:
    assert {*found.poses} == {"front", "right"}
    for name, pose in found.poses.items():
        metres, radians = pose.distance_to(truth.between(found.target, name))
        assert metres < 0.01
        assert radians < np.deg2rad(0.1)
    covariances = {each.lidar: each.covariance for each in found.placements if each.covariance is not None}
    assert {*covariances} == {*found.poses} - {found.target}
    (covariance,) = covariances.values()
    assert 0.0 < np.sqrt(np.linalg.eigvalsh(covariance)).max() < 0.02


@pytest.mark.slow
def test_lidars_without_a_pose_have_the_reason(found: CalibrationResult) -> None:
    assert {each.lidar for each in found.placements if each.status == "not_placed"} == {MOVED, MISSING}
    assert found[MISSING].reason == "it has no returns in range, or no known pose"
    said = found[MOVED].reason
    assert said.startswith(("no pose near the known one fits front: ", "no pose near the known one fits right: "))
    assert "that the other sensor's beams passed through" in said
    assert [each.lidar for each in found.placements if each.contradicts_prior] == [MOVED]


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_lidar_beside_one_that_moved_is_not_blamed() -> None:
    """The right LiDAR of this chain overlaps with the one at the front right only."""
    made = simulate_snapshot("chain", "street", 5, frames=2)
    poses = made.truth.T_target_source
    off = RigidTransform.from_xyz_rpy("front_right", "front_right", (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    known = Extrinsics(made.truth.target, {**poses, "front_right": poses["front_right"] @ off})
    found = register_from_known(made.snapshot, known)
    assert found.target == "front_left"
    assert found["front_right"].T_target_source.distance_to(made.truth.between("front_left", "front_right"))[0] < 0.1
    assert found["right"].reason.startswith("no pose near the known one fits front_right: the scene does not constrain")
    assert not any(each.contradicts_prior for each in found.placements)


def test_a_lidar_is_sought_beside_one_that_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of a chain of three was moved by 2 m; the third stands where it stood."""
    known = Extrinsics("a", {name: made_pairs.pose("a", name, ("abc".index(name), 0.0, 0.0)) for name in "abc"})
    state = SimpleNamespace(config=CalibrationConfig(), out_of_time=False, not_reached=(), cut_short=False)
    state.lidars = {name: SimpleNamespace(side=name) for name in "abc"}
    linking = verification._Linking(state, known, "abc")
    linking.accepted.append(made_pairs.pair(made_pairs.pose("a", "b", (3.0, 0.0, 0.0))))
    begun = []

    def register(_target, _source, hypotheses, _config, **_settings):
        begun.append(hypotheses[0].T_target_source)
        return made_pairs.pair(begun[-1])

    monkeypatch.setattr(verification, "register_sides", register)
    monkeypatch.setattr(verification, "_scores", lambda _, poses: poses)
    monkeypatch.setattr(verification, "_by_common_points", lambda poses: [*poses])
    linking.link_beside_moved([("a", "b"), ("b", "c")])
    assert [each.xyz_m.tolist() for each in begun] == [[-1.0, 0.0, 0.0]]
    root, poses = linking.linked
    assert {name: (poses["a"].inverse() @ poses[name]).xyz_m[0] for name in poses} == {"a": 0.0, "b": 3.0, "c": 2.0}
    assert root == "b"
    late = verification._Linking(state, known, "abc", accepted=linking.accepted[:1])
    state.out_of_time = True
    late.link_beside_moved([("a", "b"), ("b", "c")])
    assert (state.cut_short, state.not_reached, len(begun)) == (True, (("b", "c"),), 1)


def test_a_known_pose_needs_a_tenth_of_the_evidence() -> None:
    config = CalibrationConfig(acceptance={"min_evidence": 5.0})
    expected = config.acceptance.model_copy(update={"min_evidence": pytest.approx(5.0 - np.log(10.0), abs=0.01)})
    assert _trusting(config) == config.model_copy(update={"acceptance": expected})


def test_poses_of_other_lidars_are_refused() -> None:
    other = Extrinsics("a", {"a": RigidTransform.identity("a", "a"), "b": RigidTransform.identity("a", "b")})
    with pytest.raises(UsageError):
        register_from_known(read_snapshot(find_sample().recording), other)


def test_without_returns_of_a_known_lidar_nothing_is_tested() -> None:
    rng = np.random.default_rng(0)
    near, far = ((scale * rng.uniform(-1.0, 1.0, (2000, 3))).astype(np.float32) for scale in (0.2, 8.0))
    scans = {"a": near, "b": near, "c": far, "d": far}
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(points_m),)) for name, points_m in scans.items()))
    known = Extrinsics("a", {name: RigidTransform.identity("a", name) for name in "ab"})
    with pytest.raises(UnfitSnapshotError, match=r"no returns in range of the LiDARs with known poses \(a, b\)"):
        register_from_known(snapshot, known)


def _registered_in(monkeypatch: pytest.MonkeyPatch, known: Extrinsics, pairs: int) -> CalibrationResult:
    """Let the time be over after so many pairs."""
    asked = iter(range(1000))
    monkeypatch.setattr(CalibrationState, "out_of_time", property(lambda _: next(asked) >= pairs))
    config = with_overrides(CalibrationConfig(), ["runtime.max_time_s=600.0"])
    return register_from_known(read_snapshot(find_sample().recording), known, config)


@pytest.mark.slow
@pytest.mark.in_turn
def test_pairs_for_which_there_is_no_time_are_told(monkeypatch: pytest.MonkeyPatch, truth: Extrinsics) -> None:
    none = _registered_in(monkeypatch, truth, 0)
    assert none.pairs == ()
    pairs = [pair for pair in combinations(("front", "left", "rear", "right"), 2) if pair != ("front", "rear")]
    assert none.time_limit == TimeLimit(600.0, tuple(pairs))  # front and rear share nothing
    some = _registered_in(monkeypatch, truth, 1)
    assert some.time_limit is not None
    assert len(some.pairs) == 1
    assert {*some.poses} == some.pairs[0].lidars
    for name in {"left", "right", "rear", "front"} - {*some.poses}:
        assert some[name].reason.startswith("the time limit (--max-time) ended the check before its pairs with ")


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_lidar_that_time_leaves_out_is_not_called_moved(monkeypatch: pytest.MonkeyPatch, truth: Extrinsics) -> None:
    moved = RigidTransform.from_xyz_rpy(truth.target, truth.target, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    known = Extrinsics(truth.target, {**truth.T_target_source, MOVED: moved @ truth.T_target_source[MOVED]})
    cut = _registered_in(monkeypatch, known, 2)
    assert any(MOVED in pair for pair in cut.time_limit.not_reached)
    assert not any(each.contradicts_prior for each in cut.placements)
    whole = _registered_in(monkeypatch, known, 1000)
    assert whole.time_limit is None
    assert [each.lidar for each in whole.placements if each.contradicts_prior] == [MOVED]
