# SPDX-License-Identifier: Apache-2.0
"""Two groups are registered from all known poses, and from those of accepted pairs."""

import pytest

from multilica.config import CalibrationConfig, preset
from multilica.results import Group, Verdict
from multilica.stages.merge import poses_between, register_groups
from tests.unit.made_pairs import ACCEPTED, pair, pose, registration, undecided

_REFUSED = Verdict("undecided")
_KNOWN = pose("a", "b", (1.0, 0.0, 0.0))
_SLID = pose("a", "b", (1.2, 0.0, 0.0))
_CHANCE = pose("a", "b", (0.0, 4.0, 0.0))
_FAR = pose("a", "b", (0.0, 36.0, 0.0))


class _Register:
    """Returns prepared registrations in turn, and keeps the calls."""

    def __init__(self, *found):
        self.found = list(found)
        self.calls = []

    def __call__(self, group, other, hypotheses, fit):
        assert (group.root, other.root) == ("a", "b")
        self.calls.append(([each.T_target_source.matrix.tolist() for each in hypotheses], fit))
        return self.found[len(self.calls) - 1]


def _registered(register, *pairs, verified=(), config=CalibrationConfig()):  # noqa: B008
    return register_groups(Group.of_one("a"), Group.of_one("b"), pairs, verified, register, config)


@pytest.mark.parametrize(
    ("of_pair", "alone", "calls", "expected"),
    [
        (ACCEPTED, ACCEPTED, 2, _KNOWN),
        (ACCEPTED, _REFUSED, 2, _CHANCE),
        (_REFUSED, ACCEPTED, 1, _CHANCE),
    ],
    ids=["the pose of an accepted pair", "refused for the groups", "the pose of a refused pair"],
)
def test_a_chance_pose_does_not_refuse_an_accepted_pair(of_pair, alone, calls, expected):
    register = _Register(pair(_CHANCE, _REFUSED), pair(_KNOWN, alone))
    found = _registered(register, pair(_KNOWN, of_pair))
    assert register.calls == [([_KNOWN.matrix.tolist()], not of_pair.accepted)] * calls
    assert found.T_target_source is expected


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (pair(_CHANCE, _REFUSED, fitness=0.9), _CHANCE),
        (pair(_CHANCE, Verdict("reject"), fitness=0.9), _KNOWN),
        (pair(_KNOWN, _REFUSED, fitness=0.9), _KNOWN),
        (pair(_CHANCE, _REFUSED, fitness=0.1), _KNOWN),
        (pair(_FAR, _REFUSED, fitness=0.9), _KNOWN),
    ],
    ids=["more evidence", "rejected", "the same pose", "less evidence", "beyond the baseline"],
)
def test_more_evidence_elsewhere_outweighs_an_accepted_pair(found, expected):
    result = _registered(_Register(found, pair(_KNOWN)), pair(_KNOWN))
    assert result.T_target_source is expected
    assert result.verdict.accepted is (expected is _KNOWN)


def _unconstrained(at, perturbed_offset_m=0.02, codes=("not_observable",), competing=0):
    registrations = (registration(at, perturbed_offset_m),) * (1 + competing)
    return pair(at, undecided(*codes), registrations=registrations)


@pytest.mark.parametrize(
    ("again", "accepted"),
    [
        (_unconstrained(_KNOWN), True),
        (_unconstrained(_KNOWN.inverse()), True),
        (_unconstrained(_KNOWN, perturbed_offset_m=0.2), False),
        (_unconstrained(_SLID), False),
        (_unconstrained(_KNOWN, competing=1), False),
        (_unconstrained(_KNOWN, codes=("not_observable", "structure_unexplained")), False),
    ],
    ids=["moves a little", "the other way round", "slides", "has slid", "a pose competes", "explains little"],
)
def test_an_accepted_pair_constrains_what_moves_a_little(again, accepted):
    rejected = pair(_CHANCE, Verdict("reject"))
    found = _registered(_Register(rejected, again), pair(_KNOWN))
    assert found.verdict.accepted is accepted
    assert found.T_target_source is (again.T_target_source if accepted else _CHANCE)


def test_an_accepted_registration_is_taken_at_once():
    register = _Register(pair(_CHANCE))
    assert _registered(register, pair(_KNOWN)).T_target_source is _CHANCE
    assert len(register.calls) == 1


def test_without_verification_the_first_registration_is_taken():
    register = _Register(pair(_CHANCE, Verdict("reject")))
    assert _registered(register, pair(_KNOWN), config=preset("paper")).T_target_source is _CHANCE


def test_the_poses_are_those_of_pairs_and_of_verified_hypotheses():
    contradicted = pair(_SLID, undecided("cycle_contradicted"))
    register = _Register(pair(_KNOWN))
    _registered(register, pair(_KNOWN, _REFUSED), contradicted, verified=[_CHANCE, _FAR])
    assert register.calls == [([_KNOWN.matrix.tolist(), _CHANCE.matrix.tolist()], True)]


def test_without_a_known_pose_there_is_no_registration():
    register = _Register()
    assert _registered(register, pair(_SLID, undecided("cycle_contradicted")), verified=[_FAR]) is None
    assert register.calls == []


def test_poses_between_groups_are_those_of_pairs_across_them():
    left = Group("a", {"a": pose("a", "a"), "c": pose("a", "c")})
    verified = {
        ("a", "b"): [registration(_KNOWN), registration(_CHANCE)],
        ("a", "c"): [registration(pose("a", "c"))],
        ("b", "d"): [registration(pose("b", "d"))],
    }
    assert poses_between(left, Group.of_one("b"), verified) == [_KNOWN, _CHANCE]


def test_a_pose_between_members_gives_that_between_the_roots():
    left = Group("a", {"a": pose("a", "a"), "c": pose("a", "c", (2.0, 0.0, 0.0), 0.4)})
    right = Group("b", {"b": pose("b", "b"), "d": pose("b", "d", (0.0, 1.0, 0.5), -0.3)})
    between = left.poses["c"].inverse() @ _KNOWN @ right.poses["d"]
    for known in (between, between.inverse()):
        found = left.pose_of(right, known)
        assert (found.target, found.source) == ("a", "b")
        assert found.distance_to(_KNOWN) == pytest.approx((0.0, 0.0), abs=1e-9)
