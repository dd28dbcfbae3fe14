# SPDX-License-Identifier: Apache-2.0
"""Links between stops are searched a second time only where that may end differently."""

from types import SimpleNamespace

import pytest

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration import links
from multilica.orchestration.stop_views import DriveStop
from multilica.results import DriveView, PairRegistration, Reason, Verdict
from multilica.workers import Workers

_STOPS = [DriveStop(name, {"front": object(), "rear": object()}, ()) for name in ("stop 1", "stop 2")]
_VIEWS = {DriveView(lidar, stop.name): object() for stop in _STOPS for lidar in stop.lidars}
_FRONT = DriveView("front", "stop 1")


@pytest.fixture
def search(monkeypatch):
    """Search with made outcomes; returns the searched pairs, each as often as it was searched."""

    def run(outcome, freed, code="empty_space_violated"):
        searched = []

        def made(_, request):
            searched.append(request.pair)
            pose = RigidTransform.identity(*request.pair)
            verdict = Verdict(outcome, (Reason(code, 1.0, 0.0, "made"),))
            found = PairRegistration(*request.pair, pose, 0.1, 0.1, 1, None, None, "", verdict=verdict)
            return SimpleNamespace(registration=None if outcome == "none" else found)

        monkeypatch.setattr(links, "levels_of", lambda *_: {})
        monkeypatch.setattr(links, "prepare_views", lambda *_: _VIEWS)
        monkeypatch.setattr(links, "with_movable", lambda *_: {view: object() for view in freed})
        monkeypatch.setattr(links, "priority_of", lambda *_: 10.0)
        monkeypatch.setattr(links, "search_pair", made)
        assert links.search_links(_STOPS, CalibrationConfig(), Workers()).links == ()
        return searched

    return run


@pytest.mark.parametrize("outcome", ["reject", "undecided", "none"])
def test_nothing_is_searched_twice_without_movable_objects(search, outcome):
    searched = search(outcome, [])
    assert len({*searched}) == len(searched) == 4


def test_refused_pairs_of_views_with_such_objects_are(search):
    searched = search("reject", [_FRONT])
    twice = {pair for pair in searched if searched.count(pair) == 2}
    assert twice == {pair for pair in searched if _FRONT.label in pair}
    assert len(twice) == 2


@pytest.mark.parametrize(
    ("outcome", "code"),
    [("undecided", "empty_space_violated"), ("none", ""), ("reject", "too_little_evidence")],
)
def test_pairs_that_fewer_beams_do_not_decide_are_not(search, outcome, code):
    assert len(search(outcome, [_FRONT], code)) == 4
