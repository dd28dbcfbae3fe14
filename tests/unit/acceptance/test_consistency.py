# SPDX-License-Identifier: Apache-2.0
"""A rig of four LiDARs, each pair measured, of which one is off."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.acceptance.consistency import doubted_lidars, most_contradicting, outlier
from multilica.acceptance.rig import is_contradicted
from multilica.config import CalibrationConfig, with_overrides
from multilica.orchestration import refinement
from multilica.orchestration.refinement import refine_rig
from multilica.orchestration.rig import result_of
from multilica.orchestration.state import CalibrationState
from multilica.results import Group, MergeCandidate, MergeDecision, PairResidual, PreprocessedCloud, Reason, Verdict
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.unit.acceptance.made_rig import IN_A, linked

_SIGMA_RAD, _SIGMA_M = 1e-4, 2e-3
_INFORMATION = np.diag(np.repeat([_SIGMA_RAD, _SIGMA_M], 3) ** -2.0)


def _calibrated(pairs, merges=(), frames=1):
    """The state after the refinement of a rig whose pairs were all merged, and some groups."""
    point = np.ones((1, 3), dtype=np.float32)
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(point),) * frames) for name in IN_A), "made")
    config = with_overrides(CalibrationConfig(target="a"), ["verify.enabled=false"])
    state = CalibrationState(snapshot, config, lambda _: None)
    state.clouds = {name: PreprocessedCloud(name, point, point) for name in IN_A}
    state.registrations = {(pair.target, pair.source): pair for pair in pairs}
    state.merges = list(merges)
    state.target, state.group = "a", Group("a", dict(IN_A))
    for name in "bcd":
        chosen = MergeCandidate("a", name, 0.5, 0.05, passes=True)
        state.decisions.append(MergeDecision(1, (chosen,), chosen, "made", ((name,),)))
    refine_rig(state)
    return state


def _pairs(*off, by_m=0.0, names="abcd"):
    """Pairs at their true poses, but for those that are off along x."""
    pairs = []
    for target, source in combinations(names, 2):
        made = replace(linked(target, source), information=_INFORMATION)
        if target + source in off:
            pose = made.T_target_source
            shifted = type(pose).from_rotation_translation(
                target, source, pose.rotation, pose.xyz_m + np.array([by_m, 0.0, 0.0])
            )
            made = replace(made, T_target_source=shifted)
        pairs.append(made)
    return pairs


def _residual(target, source, probability, apart_m=0.01):
    return PairResidual(target, source, 0.0, 0.0, 0.0, 0.0, 1.0, probability, apart_m, 0.01)


def test_pairs_that_agree_leave_no_lidar_in_doubt():
    state = _calibrated(_pairs())
    assert state.doubts == {}
    assert {each.reason for each in result_of(state).placements} == {"the target", "placed"}


@pytest.mark.parametrize("by_m", [0.083, -0.9])
def test_two_ways_between_its_lidars_tell_a_wrong_pair(by_m):
    result = result_of(_calibrated(_pairs("bc", by_m=by_m), frames=2))
    assert {each.reason for each in result.placements} == {"the target", "placed"}
    assert [pair.lidars for pair in result.pairs if not pair.verdict.accepted] == [{"b", "c"}]
    for name, truth in IN_A.items():
        assert result[name].T_target_source.distance_to(truth)[0] < 1e-6


def test_two_wrong_pairs_tell_nothing():
    """Without either of them, the other contradicts the rest."""
    made = zip(_pairs("bc", by_m=0.3), _pairs("bd", by_m=-0.4), strict=True)
    result = result_of(_calibrated([other if one.lidars == {"b", "d"} else one for one, other in made], frames=2))
    assert not result["b"].placed


def test_of_equally_improbable_pairs_the_loosest_goes():
    tight, loose, far = (
        replace(_residual("a", "b", probability), weight=weight)
        for probability, weight in ((1.0e-9, 0.9), (1.1e-9, 0.2), (1e-5, 0.1))
    )
    assert most_contradicting([tight, loose, far]) is loose
    assert most_contradicting([far]) is far


@pytest.mark.parametrize(("of_others", "found"), [(0.9, True), (1e-9, False)])
def test_a_pair_is_wrong_only_if_all_others_agree(of_others, found):
    wrong = _residual("b", "c", 1e-12)
    told = outlier(_pairs(), [wrong, _residual("a", "b", 1e-9)], lambda _: [_residual("a", "b", of_others)])
    assert (told is wrong) is found


@pytest.mark.parametrize(("by_m", "frames", "names"), [(0.083, 1, "abcd"), (-0.9, 1, "abcd"), (0.083, 2, "abc")])
def test_a_large_contradiction_leaves_its_cycle_without_poses(by_m, frames, names):
    """With one frame, the majority may have matched what moved; in a triangle, there is none."""
    state = _calibrated(_pairs("bc", by_m=by_m, names=names), frames=frames)
    result = result_of(state)
    lost = {each.lidar for each in result.placements if each.status == "not_placed"}
    assert {"b", "c"} <= lost
    assert all(is_contradicted(pair) for pair in result.pairs if pair.lidars & lost)
    assert "c against b contradicts the other pairs of its cycle by" in result["c"].reason
    assert not any(pair.lidars & lost for pair in result.trusted)
    assert not any(pair.contradicts for pair in state.refinement.pairs)


_UNCERTAIN = Verdict("uncertain")


def _merged_with_a_lost_one(*further):
    """The state where b and c contradict each other, and d was merged into the group of a and b."""
    cycle = [pair for pair in _pairs("bc", by_m=0.3) if "d" not in pair.lidars]
    merge = [_weak(pair) for pair in _pairs() if pair.lidars in ({"a", "d"}, {"b", "d"})]
    return _calibrated([*cycle, *further], [tuple(merge)])


def _weak(pair, verdict=_UNCERTAIN):
    return replace(pair, verdict=verdict, information=_INFORMATION / 1e4)


def test_a_merge_with_a_lost_lidar_leaves_an_uncertain_pair():
    """Without it, it would be placed with no pair that gives its sigma."""
    (of_d,) = (_weak(pair) for pair in _pairs() if pair.lidars == {"a", "d"})
    result = result_of(_merged_with_a_lost_one(of_d))
    assert [result[name].status for name in "bcd"] == ["not_placed", "not_placed", "uncertain"]
    assert of_d in result.trusted
    np.testing.assert_allclose(result["d"].covariance, np.linalg.inv(of_d.information), rtol=0.5, atol=1e-12)


@pytest.mark.parametrize("verdict", [None, Verdict("reject")], ids=["no pair", "refused"])
def test_what_only_a_lost_lidar_joins_is_not_placed(verdict):
    of_d = [_weak(pair, verdict) for pair in _pairs() if pair.lidars == {"a", "d"} and verdict is not None]
    state = _merged_with_a_lost_one(*of_d)
    assert result_of(state)["d"].status == "not_placed"
    assert state.decisions[-1].reason.endswith("without these nothing joins d")
    assert ("d",) in state.decisions[-1].groups


def test_lidars_that_an_undecided_pair_excludes_lose_their_poses(monkeypatch):
    """A merge may join a LiDAR at the true pose to a group with a wrong one."""
    reason = Reason("cycle_contradicted", 6.9, 0.0, "made")
    monkeypatch.setattr(refinement, "excluded_lidars", lambda *_: {"b": reason, "d": reason})
    state = _calibrated(_pairs())
    result = result_of(state)
    assert [result[name].status for name in "abcd"] == ["placed", "not_placed", "placed", "not_placed"]
    assert result["b"].reason.endswith("made")
    assert state.decisions[-1].reason == "b, d left the group: made"


@pytest.mark.parametrize(("by_m", "status"), [(0.018, "placed"), (0.045, "uncertain")])
def test_a_small_contradiction_widens_sigma_to_cover_both(by_m, status):
    state = _calibrated(_pairs("bc", by_m=by_m))
    sound, found = result_of(_calibrated(_pairs())), result_of(state)
    for name in state.doubts:
        assert found[name].status == status
        assert "sigma covers that c against b contradicts" in found[name].reason
        apart_m = max(each.apart_m for each in state.refinement.pairs)
        expected = np.hypot(sound[name].sigma_xyz_m, apart_m)
        np.testing.assert_allclose(found[name].sigma_xyz_m, expected, rtol=0.1)
    assert {"b", "c"} <= state.doubts.keys()


def test_all_lidars_of_a_ring_are_in_doubt():
    ring = [pair for pair in _pairs() if {pair.target + pair.source} & {"ab", "bc", "cd", "ad"}]
    found = doubted_lidars("a", ring, [_residual("b", "c", 1e-9), _residual("c", "d", 1e-12)])
    assert {name: residual.probability for name, residual in found.items()} == {"b": 1e-12, "c": 1e-12, "d": 1e-12}


def test_lidars_behind_a_cycle_are_in_doubt_and_others_not():
    pairs = [pair for pair in _pairs() if pair.lidars in ({"a", "b"}, {"a", "c"}, {"b", "c"}, {"c", "d"})]
    doubted = doubted_lidars("a", pairs, [_residual("b", "c", 1e-9)])
    assert sorted(doubted) == ["b", "c", "d"]
    behind_target = [pair for pair in _pairs() if pair.lidars in ({"a", "b"}, {"a", "c"}, {"b", "c"}, {"a", "d"})]
    assert sorted(doubted_lidars("a", behind_target, [_residual("b", "c", 1e-9)])) == ["b", "c"]


def test_a_probable_residual_doubts_nothing():
    assert doubted_lidars("a", _pairs(), [_residual("b", "c", 0.002, apart_m=1.0)]) == {}
