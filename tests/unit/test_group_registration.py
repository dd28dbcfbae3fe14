# SPDX-License-Identifier: Apache-2.0
"""Groups that were registered as wholes beside the pairs that were accepted."""

from dataclasses import replace

import numpy as np
import pytest

from multilica import events, pipeline, testimony
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, Hold, PairRegistration, Reason, Verdict
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.merge import Group

_ACCEPTED, _REFUSED = Verdict("accept"), Verdict("undecided")
_HINTED = RigidTransform.from_xyz_rpy("a", "b", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
_FAR = RigidTransform.from_xyz_rpy("a", "b", (0.0, 36.0, 0.0), (0.0, 0.0, 0.0))
_CHANCE = RigidTransform.from_xyz_rpy("a", "b", (0.0, 4.0, 0.0), (0.0, 0.0, 0.0))


def _link(pose, verdict, fitness=0.5):
    return PairRegistration(
        "a", "b", pose, fitness, 0.05, 100, converged=True, iterations=5, engine="made", verdict=verdict
    )


@pytest.mark.parametrize(
    ("hint", "alone", "asked", "placed_at"),
    [
        (_ACCEPTED, _ACCEPTED, 2, _HINTED),
        (_ACCEPTED, _REFUSED, 2, _CHANCE),
        (_REFUSED, _ACCEPTED, 1, _CHANCE),
    ],
    ids=["an accepted pair stands", "but not against the whole", "a refused pair has no say"],
)
def test_chance_fits_of_the_whole_do_not_outvote_an_accepted_pair(monkeypatch, hint, alone, asked, placed_at):
    tries = []

    def register_groups(*arguments, fit):
        known = list(arguments[-1])
        tries.append(known)
        assert fit is not hint.accepted
        if known == [_HINTED] and len(tries) == 2:
            return _link(_HINTED, alone)
        return _link(_CHANCE, _REFUSED) if known else None

    monkeypatch.setattr(pipeline._Run, "_register_groups", register_groups)
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(np.ones((1, 3))),)) for name in "ab"))
    run = pipeline._Run(snapshot, CalibrationConfig(), events.ignore)
    link = run._reregister(Group.of_one("a"), Group.of_one("b"), [_link(_HINTED, hint)])
    assert len([known for known in tries if known]) == asked
    assert link.T_target_source is placed_at


@pytest.mark.parametrize(
    ("elsewhere", "placed_at"),
    [
        (_link(_CHANCE, _REFUSED, fitness=0.9), _CHANCE),
        (_link(_CHANCE, Verdict("reject"), fitness=0.9), _HINTED),
        (_link(_HINTED, _REFUSED, fitness=0.9), _HINTED),
        (_link(_CHANCE, _REFUSED, fitness=0.1), _HINTED),
        (_link(_FAR, _REFUSED, fitness=0.9), _HINTED),
    ],
    ids=["outdone", "rejected", "the same pose", "less evidence", "on no vehicle"],
)
def test_an_accepted_pair_does_not_stand_against_more_evidence_elsewhere(monkeypatch, elsewhere, placed_at):
    links = iter([elsewhere, _link(_HINTED, _ACCEPTED)])
    monkeypatch.setattr(pipeline._Run, "_register_groups", lambda *_, **__: next(links))
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(np.ones((1, 3))),)) for name in "ab"))
    run = pipeline._Run(snapshot, CalibrationConfig(), events.ignore)
    link = run._reregister(Group.of_one("a"), Group.of_one("b"), [_link(_HINTED, _ACCEPTED)])
    assert link.T_target_source is placed_at
    assert link.verdict.accepted is (placed_at is _HINTED)


def _held_at(pushed_off_m, pose=_HINTED, codes=("not_observable",), answers=1):
    hold = Hold(0.005, 1e-3, 0.3, pushed_off_m, 0.0)
    told = testimony.Testimony(200, 0, 0, 0, np.eye(6), np.zeros(0, dtype=np.uint8))
    answer = Assessment(-1, pose, told, 0.5, 0.05, 1.0, np.zeros((0, 3)), hold=hold)
    reasons = tuple(Reason(code, 0.0, 1.0, "made") for code in codes)
    return replace(_link(pose, Verdict("undecided", reasons)), assessments=(answer,) * answers)


_SLID = RigidTransform.from_xyz_rpy("a", "b", (1.2, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("link", "accepted"),
    [
        (_held_at(0.02), True),
        (_held_at(0.2), False),
        (_held_at(0.02, _SLID), False),
        (_held_at(0.02, answers=2), False),
        (_held_at(0.02, codes=("not_observable", "structure_unexplained")), False),
    ],
    ids=["gives way a little", "slides", "has slid", "has a rival", "explains little"],
)
def test_a_pair_upholds_only_what_gives_way_a_little_where_it_was_accepted(link, accepted):
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(np.ones((1, 3))),)) for name in "ab"))
    run = pipeline._Run(snapshot, CalibrationConfig(), events.ignore)
    assert run._upheld(link, [_HINTED]).verdict.accepted is accepted


@pytest.mark.parametrize(
    ("before", "again"),
    [
        (_held_at(0.5), False),
        (_held_at(0.5, pose=_CHANCE), True),
        (_held_at(0.5, codes=("ambiguous",)), True),
        (_held_at(0.5, codes=("ambiguous", "not_observable")), True),
        (None, True),
    ],
    ids=["too loose there", "elsewhere", "one of two answers", "loose and one of two", "never registered"],
)
def test_a_loop_is_closed_unless_the_pair_was_too_loose_at_that_very_pose(monkeypatch, before, again):
    asked = []

    def register(*arguments):
        candidates = arguments[-1]
        asked.extend(each.T_target_source for each in candidates)
        return _link(candidates[0].T_target_source, _ACCEPTED)

    monkeypatch.setattr(pipeline._Run, "_register", register)
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(np.ones((1, 3))),)) for name in "ab"))
    run = pipeline._Run(snapshot, CalibrationConfig(), events.ignore)
    run.clouds = dict.fromkeys("ab")
    run.sides = dict.fromkeys("ab")
    run.registrations = {} if before is None else {("a", "b"): before}
    run._close_loops(Group("a", {"a": RigidTransform.identity("a", "a"), "b": _HINTED}))
    assert [pose.matrix.tolist() for pose in asked] == ([_HINTED.matrix.tolist()] if again else [])
    assert run.registrations["a", "b"].verdict.accepted is again
