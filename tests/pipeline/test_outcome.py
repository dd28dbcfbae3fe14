# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.acceptance.placement import contested_place
from multilica.config import CalibrationConfig
from multilica.events import ignore
from multilica.extrinsics import Extrinsics
from multilica.orchestration.rig import placement_of
from multilica.orchestration.state import CalibrationState
from multilica.results import Group, MergeCandidate, MergeDecision
from multilica_cli.options import Parameters, sigma_limits
from tests.unit.made_pairs import UNCERTAIN, pair, pose, registration, undecided

_POSES = {"a": pose("a", "a"), "b": pose("a", "b", (1.0, 0.0, 0.0), 0.3)}
_PLACE = pose("a", "c", (0.0, 2.0, 0.0))
_OTHER = pose("a", "c", (0.0, 5.0, 0.0), np.pi / 2)
_FROM_B = _POSES["b"].inverse() @ _OTHER


def test_two_accepted_pairs_contest_the_place_of_a_lidar():
    pairs = [pair(_FROM_B, fitness=0.4), pair(_PLACE, fitness=0.9)]
    contested = contested_place("c", _POSES, pairs, registration)
    assert (contested.pair, contested.other) == (("a", "c"), ("b", "c"))
    assert (contested.distance_m, contested.angle_deg) == pytest.approx((3.0, 90.0))
    assert contested.competing.T_target_source.distance_to(_OTHER) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_competing_pose_goes_the_way_of_its_pair():
    pairs = [pair(_FROM_B, fitness=0.4), pair(_PLACE.inverse(), fitness=0.9)]
    contested = contested_place("c", _POSES, pairs, registration)
    assert contested.pair == ("c", "a")
    competing = contested.competing.T_target_source
    assert competing.distance_to(_OTHER.inverse()) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_without_verification_the_competing_pose_is_unknown():
    contested = contested_place("c", _POSES, [pair(_PLACE), pair(_FROM_B)])
    assert contested.competing is None


@pytest.mark.parametrize(
    "second",
    [
        pair(_POSES["b"].inverse() @ _PLACE),
        pair(_FROM_B, undecided("ambiguous")),
        pair(pose("d", "c", (9.0, 0.0, 0.0))),
        pair(pose("b", "d", (9.0, 0.0, 0.0))),
    ],
    ids=["agrees", "not accepted", "with a LiDAR that is not placed", "of another LiDAR"],
)
def test_a_place_is_contested_only_by_accepted_pairs(second):
    assert contested_place("c", _POSES, [pair(_PLACE), second]) is None


_CHOSEN = MergeCandidate("a", "b", 0.6, 0.04, passes=True)
_REFUSED = MergeCandidate("a", "c", 0.3, 0.05, passes=False, reason="too little in common")


def _placement(name, *pairs, with_returns="abc", until="ground", prior=None, sigma_m=1e-3, config=None):
    state = CalibrationState(
        snapshot=None,
        config=config or CalibrationConfig(until=until),
        observe=ignore,
        prior=prior,
        clouds=dict.fromkeys(with_returns),
        registrations={(each.target, each.source): each for each in pairs},
        decisions=[MergeDecision(0, (_CHOSEN, _REFUSED), _CHOSEN, "made", (("a", "b"), ("c",)))],
        group=Group("a", _POSES),
        covariances={"b": np.diag([1e-6] * 3 + [sigma_m**2] * 3)},
    )
    return placement_of(name, "a", state)


def test_the_target_has_the_identity():
    placement = _placement("a")
    assert placement.placed
    assert placement.reason == "the target"
    assert np.array_equal(placement.T_target_source.matrix, np.eye(4))


def test_a_placed_lidar_has_the_figures_of_its_merge():
    placement = _placement("b", prior=Extrinsics("a", {"b": pose("a", "b", (1.0, 0.1, 0.0), 0.3)}))
    assert placement.T_target_source is _POSES["b"]
    assert (placement.fitness, placement.rmse_m, placement.reason) == (0.6, 0.04, "placed")
    assert np.array_equal(placement.covariance, np.eye(6) * 1e-6)
    assert placement.prior_deviation == pytest.approx((0.1, 0.0))


def test_a_lidar_with_a_sigma_above_the_limit_is_uncertain():
    placement = _placement("b", sigma_m=0.03)
    assert (placement.status, placement.reason) == ("uncertain", "sigma 30 mm, limit 20 mm")
    assert placement.T_target_source is _POSES["b"]
    assert placement.sigma_xyz_m == pytest.approx([0.03] * 3)
    assert (placement.fitness, placement.rmse_m) == (0.6, 0.04)


@pytest.mark.parametrize(
    ("limits", "status"), [("31,0.2", "placed"), ("29,0.2", "uncertain"), ("31,0.05", "uncertain")]
)
def test_max_sigma_moves_the_limit(limits, status):
    config = Parameters().resolve(sigma_limits(limits))
    assert _placement("b", sigma_m=0.03, config=config).status == status


@pytest.mark.parametrize(
    ("pairs", "found", "reason"),
    [
        ([], {"with_returns": "ab"}, "it has no returns in range"),
        ([], {"until": "fine"}, "the run stopped after stage fine (--until)"),
        ([], {}, "no pose was found against any other LiDAR"),
        (
            [pair(_PLACE, undecided("ambiguous")), pair(_FROM_B, undecided("too_far_apart"), fitness=0.1)],
            {},
            "its best registration, with a: made ambiguous",
        ),
        ([pair(_PLACE)], {}, "its best registration, with a: too little in common"),
        ([pair(_PLACE, UNCERTAIN)], {}, "its best registration, with a: too little in common"),
    ],
    ids=["no returns", "stopped", "no pair", "refused", "refused by the merge", "uncertain and refused by the merge"],
)
def test_a_lidar_that_is_not_placed_has_a_reason(pairs, found, reason):
    placement = _placement("c", *pairs, **found)
    assert not placement.placed
    assert placement.T_target_source is None
    assert placement.reason == reason
