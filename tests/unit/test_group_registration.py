# SPDX-License-Identifier: Apache-2.0
"""Groups that were registered as wholes beside the pairs that were accepted."""

import numpy as np
import pytest

from multilica import events, pipeline
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Verdict
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.merge import Group

_ACCEPTED, _REFUSED = Verdict("accept"), Verdict("undecided")
_HINTED = RigidTransform.from_xyz_rpy("a", "b", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
_CHANCE = RigidTransform.from_xyz_rpy("a", "b", (0.0, 4.0, 0.0), (0.0, 0.0, 0.0))


def _link(pose, verdict):
    return PairRegistration(
        "a", "b", pose, 0.5, 0.05, 100, converged=True, iterations=5, engine="made", verdict=verdict
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

    def register_groups(*arguments):
        known = list(arguments[-1])
        tries.append(known)
        if known == [_HINTED] and len(tries) == 2:
            return _link(_HINTED, alone)
        return _link(_CHANCE, _REFUSED) if known else None

    monkeypatch.setattr(pipeline._Run, "_register_groups", register_groups)
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(np.ones((1, 3))),)) for name in "ab"))
    run = pipeline._Run(snapshot, CalibrationConfig(), events.ignore)
    link = run._reregister(Group.of_one("a"), Group.of_one("b"), [_link(_HINTED, hint)])
    assert len([known for known in tries if known]) == asked
    assert link.T_target_source is placed_at
