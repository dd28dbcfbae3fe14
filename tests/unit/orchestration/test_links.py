# SPDX-License-Identifier: Apache-2.0
"""Links between stops are searched a second time only where that may end differently."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration import link_search, links
from multilica.orchestration.stop_views import DriveStop
from multilica.results import DriveView, PairRegistration, Reason, Verdict, ViewPair
from multilica.workers import Workers

_STOPS = [DriveStop(name, {"front": object(), "rear": object()}, ()) for name in ("stop 1", "stop 2")]
_VIEWS = {DriveView(lidar, stop.name): object() for stop in _STOPS for lidar in stop.lidars}
_FRONT = DriveView("front", "stop 1")
_FURTHER = [*_STOPS, replace(_STOPS[0], name="stop 3")]
_MORE = [replace(stop, lidars={**stop.lidars, "left": object()}) for stop in _FURTHER]


@pytest.fixture
def search(monkeypatch):
    """Search with made outcomes; returns the searched pairs, each as often as it was searched."""

    def run(outcome, freed, code="empty_space_violated", stops=_STOPS, priority=10.0):
        searched = []

        def made(_, request):
            searched.append(request.pair)
            pose = RigidTransform.identity(*request.pair)
            verdict = Verdict(outcome, (Reason(code, 1.0, 0.0, "made"),))
            found = PairRegistration(*request.pair, pose, 0.1, 0.1, 1, None, None, "", verdict=verdict)
            return SimpleNamespace(registration=None if outcome == "none" else found)

        monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
        monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
        monkeypatch.setattr(link_search, "with_movable", lambda *_: {view: object() for view in freed})
        monkeypatch.setattr(link_search, "priority_of", lambda *_: priority)
        monkeypatch.setattr(link_search, "search_pair", made)
        assert links.search_links(stops, CalibrationConfig(), Workers()).links == ()
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


def test_pairs_left_by_a_vain_search_stay_unsearched(search):
    """Objects that may have left are no reason to go on where no beam through one refused a pair."""
    searched = search("undecided", [_FRONT], stops=_MORE)
    assert 9 <= len(searched) < 27
    assert searched == search("undecided", [], stops=_MORE)
    assert len(search("reject", [_FRONT], stops=_MORE)) > len(searched)


@pytest.mark.parametrize(("stops", "count"), [(_FURTHER, 12), (_MORE, 0)], ids=["few", "many"])
def test_few_pairs_are_all_searched(search, stops, count):
    """Those that promise little, too, and after as many failures as views."""
    assert len({*search("undecided", [], stops=stops, priority=1.0)}) == count


def test_registrations_with_less_evidence_are_weak_links(monkeypatch):
    """They connect no views, so that all pairs are searched."""
    searched = []

    def made(_, request):
        searched.append(request.pair)
        fitness = 9.0 if len(searched) == 1 else 0.1  # without beams, it stands for the evidence
        pose, verdict = RigidTransform.identity(*request.pair), Verdict("uncertain")
        return SimpleNamespace(
            registration=PairRegistration(
                *request.pair, pose, fitness, 0.1, 1, None, None, "", information=np.eye(6), verdict=verdict
            )
        )

    monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "with_movable", lambda *_: {})
    monkeypatch.setattr(link_search, "priority_of", lambda *_: 10.0)
    monkeypatch.setattr(link_search, "search_pair", made)
    found = links.search_links(_STOPS, CalibrationConfig(), Workers())
    assert len(found.links) == 1
    assert len(found.weak) == 3
    assert len(searched) == 4


@pytest.mark.parametrize(
    ("better", "turn_rad", "yaw_rad", "outcomes"),
    [
        ((-0.1, 4.0), 0.0, 0.0, ("undecided", "undecided")),
        ((-0.1, 4.0), np.pi, 0.0, ("undecided", "undecided")),
        ((-0.1, 4.0), 1.2, 0.0, ("undecided", "accept")),
        ((-0.1, 4.0), 0.0, 1.2, ("undecided", "accept")),
        ((-0.1, 4.0), 1.2, 1.2, ("undecided", "accept")),
        (None, 0.0, 0.0, ("accept", "accept")),
    ],
)
def test_a_better_place_along_the_way_doubts_links(monkeypatch, better, turn_rad, yaw_rad, outcomes):
    """It doubts the links of these two LiDARs that slide along the same axis, and none of a LiDAR with itself."""
    worse = ("front at stop 1", "rear at stop 2")

    def made(_, request):
        axis, pose = np.array([1.0, 0.0, 0.0]), RigidTransform.identity(*request.pair)
        if request.pair != worse:
            axis = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
            pose = RigidTransform.from_xyz_rpy(*request.pair, [0.0, 0.0, 0.0], [0.0, 0.0, yaw_rad])
        best = SimpleNamespace(evidence=9.0, pair=request.pair, visibility=SimpleNamespace(slide_direction=axis))
        found = PairRegistration(*request.pair, pose, 0.9, 0.1, 1, None, None, "", information=np.eye(6))
        return SimpleNamespace(registration=replace(found, registrations=(best,)))

    monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "with_movable", lambda *_: {})
    monkeypatch.setattr(link_search, "priority_of", lambda *_: 10.0)
    monkeypatch.setattr(link_search, "next_round", lambda _, __, tried, priority: [] if tried else [*priority])
    monkeypatch.setattr(link_search, "search_pair", made)
    monkeypatch.setattr(link_search, "better_along_slide", lambda _, found: better if found.pair == worse else None)
    found = links.search_links(_STOPS, CalibrationConfig(), Workers()).links
    assert len(found) == 4
    expected = dict(zip((worse, ("rear at stop 1", "front at stop 2")), outcomes, strict=True))
    for link in found:
        outcome = expected.get((link.target.label, link.source.label), "accept")
        assert link.registration.verdict.outcome == outcome
        assert link.counts == (outcome == "accept")


def test_motions_tell_where_links_between_stops_are(monkeypatch):
    """A link that was found before is kept, and not registered again."""
    here = RigidTransform.from_xyz_rpy("front", "front", [3.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    asked, made = [], Verdict("accept")

    def registered(_, start):
        pose = start.T_target_source
        asked.append(pose)
        return PairRegistration(
            pose.target, pose.source, pose, 9.0, 0.1, 99, None, None, "", information=np.eye(6), verdict=made
        )

    monkeypatch.setattr(link_search, "levels_of", lambda *_: {"front": here})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "score_roughly", lambda *_: SimpleNamespace(evidence=9.0))
    monkeypatch.setattr(link_search, "choose_loops", lambda scores, *_: [*scores])
    monkeypatch.setattr(link_search, "register_roughly_implied", registered)
    pose = PairRegistration("front", "front", here, 0.0, 0.0, 0, None, None, "", information=np.eye(6), verdict=made)
    motion = ViewPair(pose, "stop 1", "stop 2")
    rear = ViewPair(replace(pose, target="rear", source="rear"), "stop 1", "stop 2")
    before = links.FoundLinks((rear,), levels={"front": here})
    found = links.follow_motions(_STOPS, CalibrationConfig(), Workers(), before, lambda: [motion])
    assert [(link.target.label, link.source.label) for link in found.links] == [
        ("rear at stop 1", "rear at stop 2"),
        ("front at stop 1", "front at stop 2"),
    ]
    assert len(asked) == 1
    assert np.array_equal(asked[0].matrix, here.matrix)
    assert found.motions == [motion]
    assert found.levels == {"front": here}


@pytest.fixture
def registered(monkeypatch):
    """Register what is scored with made outcomes: an evidence of 9 for the front LiDAR, of 0.5 for others."""

    def made(_, start):
        pose = start.T_target_source
        fitness = 9.0 if "front" in pose.target and "front" in pose.source else 0.5
        return PairRegistration(
            pose.target,
            pose.source,
            pose,
            fitness,
            0.1,
            99,
            None,
            None,
            "",
            information=np.eye(6),
            verdict=Verdict("accept"),
        )

    monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "score_roughly", lambda *_: SimpleNamespace(evidence=0.5))
    monkeypatch.setattr(link_search, "register_roughly_implied", made)


_BOTH = {"front", "rear"}


def _poses(*views, target="stop 1"):
    """Poses of views that are 1 m apart."""
    return {
        view: RigidTransform.from_xyz_rpy(target, view.label, [float(number), 0.0, 0.0], [0.0, 0.0, 0.0])
        for number, view in enumerate(views)
    }


@pytest.mark.usefixtures("registered")
def test_views_are_linked_from_their_poses():
    """Links with little evidence are weak ones, and known links stay as they are."""
    poses = _poses(*_VIEWS)
    first = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), links.FoundLinks(), poses, _BOTH)
    assert [link.views for link in first.links] == [{_FRONT, DriveView("front", "stop 2")}]
    assert len(first.weak) == 3
    (link,) = first.links
    assert link.registration.T_target_source.xyz_m == pytest.approx([2.0, 0.0, 0.0])
    known = links.FoundLinks(first.weak[:1], first.weak)
    again = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), known, poses, _BOTH)
    assert again.links[0] is first.weak[0]
    assert {link.views for link in again.links} == {first.weak[0].views, link.views}
    assert {link.views for link in again.weak} == {each.views for each in first.weak[1:]}


@pytest.mark.usefixtures("registered")
def test_a_weak_link_goes_where_its_views_have_a_link():
    """As two, they would confirm each other."""
    poses = _poses(*_VIEWS)
    first = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), links.FoundLinks(), poses, _BOTH)
    before = links.FoundLinks(weak=(*first.weak, *first.links))
    again = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), before, poses, _BOTH)
    assert [link.views for link in again.links] == [link.views for link in first.links]
    assert {link.views for link in again.weak} == {link.views for link in first.weak}


@pytest.mark.usefixtures("registered")
def test_only_pairs_of_uncertain_lidars_are_registered():
    nothing, poses = links.FoundLinks(), _poses(*_VIEWS)
    found = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), nothing, poses, {"rear"})
    assert not found.links
    assert all("rear" in {view.lidar for view in link.views} for link in found.weak)
    assert len(found.weak) == 3


@pytest.mark.parametrize(
    ("codes", "count"), [(("not_observable",), 4), (("not_observable", "ambiguous"), 0), (("ambiguous",), 0)]
)
@pytest.mark.usefixtures("registered")
def test_links_that_slide_count_without_that_direction(monkeypatch, codes, count):
    made, poses = link_search.register_roughly_implied, _poses(*_VIEWS)
    slide = np.array([0.0, 0.0, 0.0, 0.6, 0.8, 0.0])
    verdict = Verdict("undecided", tuple(Reason(code, 0.3, 0.15, "it slides") for code in codes))

    def sliding(shared, start):
        best = SimpleNamespace(evidence=9.0, visibility=SimpleNamespace(weakest_direction=slide))
        found = made(shared, start)
        return replace(found, verdict=verdict, registrations=(best,), information=1e6 * np.eye(6))

    monkeypatch.setattr(link_search, "register_roughly_implied", sliding)
    found = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), links.FoundLinks(), poses, _BOTH)
    assert found.links == ()
    assert len(found.weak) == count
    for link in found.weak:
        sigmas = np.sqrt(np.linalg.eigvalsh(np.linalg.inv(link.registration.information)))
        assert sigmas == pytest.approx([1e-3] * 5 + [1.0], rel=1e-3)
        assert link.counts


@pytest.mark.usefixtures("registered")
def test_views_without_a_common_target_are_not_linked():
    poses = _poses(_FRONT) | _poses(DriveView("front", "stop 2"), target="stop 2")
    nothing = links.FoundLinks()
    found = links.follow_poses(_STOPS, CalibrationConfig(), Workers(), nothing, poses, _BOTH)
    assert (found.links, found.weak) == ((), ())


def test_nothing_is_registered_after_the_time_limit(monkeypatch):
    """The motions, which are read by then, are kept."""
    monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "score_roughly", lambda *_: pytest.fail("scored"))
    here = RigidTransform.identity("front", "front")
    pose = PairRegistration("front", "front", here, 0.0, 0.0, 0, None, None, "", information=np.eye(6))
    motion = ViewPair(pose, "stop 1", "stop 2")
    found = links.follow_motions(_STOPS, CalibrationConfig(), Workers(), links.FoundLinks(), lambda: [motion], 0.0)
    assert found.motions == [motion]
    assert not found.links
    assert found.not_reached == (("stop 1", "stop 2"),)


def test_pairs_without_time_are_missed(monkeypatch):
    searched = []

    def made(_, request):
        assert request.deadline_s == 2.0
        searched.append(request.pair)
        return SimpleNamespace(registration=None) if len(searched) < 3 else None

    monkeypatch.setattr(link_search, "levels_of", lambda *_: {})
    monkeypatch.setattr(link_search, "prepare_views", lambda *_: _VIEWS)
    monkeypatch.setattr(link_search, "with_movable", lambda *_: {})
    monkeypatch.setattr(link_search, "priority_of", lambda *_: 10.0)
    monkeypatch.setattr(link_search, "next_round", lambda _, __, tried, priority: sorted({*priority} - tried))
    monkeypatch.setattr(link_search, "search_pair", made)
    monkeypatch.setattr(link_search, "time", SimpleNamespace(monotonic=lambda: float(len(searched))))
    found = links.search_links(_STOPS, CalibrationConfig(), Workers(), deadline_s=2.0)
    assert len(searched) == 4
    assert found.not_reached == (("stop 1", "stop 2"),)


def test_motions_are_not_read_where_links_are_not_wanted():
    config = with_overrides(CalibrationConfig(), ["drive.max_distance_m=0"])
    nothing = links.FoundLinks()
    assert links.follow_motions(_STOPS, config, Workers(), nothing, lambda: pytest.fail("read")) is nothing
