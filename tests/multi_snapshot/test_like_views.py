# SPDX-License-Identifier: Apache-2.0
"""Systematic errors that stops of a straight drive repeat."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.config import RefineConfig
from multilica.registration.view_poses import ViewPoses
from multilica.results import BiasInformation, LinkedStops
from multilica.stages.refine import _repeated, refine
from tests.multi_snapshot.made_drive import LIDARS, STOPS, STRAIGHT, pair, pairs, refined

_LINKS = "A1-A2 A2-A3 A3-A4"
_WITHIN = "A1-B1 A2-B2 A3-B3 A4-B4"


def _likeness(one, other, stops=STRAIGHT):
    views = ViewPoses(LIDARS, stops, sorted(LIDARS), sorted(stops), [sorted(stops)])
    return views.likeness(*(pair(*each.split("-"), stops=stops) for each in (one, other)))


@pytest.mark.parametrize(
    ("one", "other", "likeness"),
    [
        ("A1-B1", "A4-B4", 1.0),
        ("A1-B1", "B4-A4", 1.0),
        ("A1-A2", "A2-A3", 1.0),
        ("A1-A2", "A3-A2", 1.0),
        ("A1-B2", "B3-A2", 1.0),
        ("A1-A2", "A1-A3", 0.46),
        ("A1-A2", "A1-A4", 0.04),
        ("A1-B2", "A2-B1", 0.04),
        ("A1-A2", "B1-B2", 0.0),
    ],
)
def test_stops_of_a_straight_drive_are_alike(one, other, likeness):
    """They are 5 m apart."""
    assert _likeness(one, other) == pytest.approx(likeness, abs=0.005)
    assert _likeness(other, one) == pytest.approx(likeness, abs=0.005)


def test_a_turn_shows_other_surfaces():
    assert _likeness("A1-B1", "A2-B2", STOPS) < 0.06
    assert _likeness("A1-A2", "A2-A3", STOPS) < 0.06


def test_stops_that_nothing_links_are_not_alike():
    """Each group of stops has a frame of its own."""
    groups = [["stop 1", "stop 2"], ["stop 3", "stop 4"]]
    views = ViewPoses(LIDARS, STRAIGHT, sorted(LIDARS), sorted(STRAIGHT), groups)
    assert views.likeness(pair("A1", "B1"), pair("A2", "B2")) == pytest.approx(1.0)
    assert views.likeness(pair("A3", "B3"), pair("A4", "B4")) == pytest.approx(1.0)
    assert views.likeness(pair("A1", "B1"), pair("A3", "B3")) == 0.0
    assert views.likeness(pair("A1", "B1"), pair("A5", "B5", stops=STRAIGHT | {"stop 5": STRAIGHT["stop 1"]})) == 0.0


def _with_systematic_errors(found):
    """Let them be as large as the random errors, in a pair whose biases nothing tells."""
    every = []
    for each in found:
        information = np.zeros((14, 14))
        information[:6, :6] = each.registration.information
        known = BiasInformation(information, np.zeros(14), 2.0 * information, information, np.zeros(8))
        every.append(replace(each, registration=replace(each.registration, bias_information=known)))
    return every


@pytest.mark.parametrize(
    ("stops", "links", "worth"),
    [(STRAIGHT, _LINKS, 5.0), (STRAIGHT, "A1-A2", 3.0 * 0.5 + 2.0 * 0.5), (STOPS, _LINKS, 2.0)],
)
def test_what_stops_repeat_does_not_average_out(stops, links, worth):
    within = _with_systematic_errors(pairs(_WITHIN, stops=stops))
    found = pairs(links, stops=stops)
    linked = LinkedStops(found, {name: stops[name] for link in found for name in link.stops}, frozenset({"stop 1"}))
    poses = {name: LIDARS[name] for name in "AB"}
    registrations = [each.registration for each in within]
    rig = refine("A", poses, registrations, RefineConfig(), linked, [each.target_stop for each in within])
    one = np.linalg.inv(within[0].registration.information)[:3, :3]
    np.testing.assert_allclose(rig.covariances["B"][:3, :3], worth / 4.0 * one, rtol=0.1, atol=1e-12)
    np.testing.assert_allclose(rig.repeatability["B"][:3, :3], one / 4.0, rtol=0.01, atol=1e-12)
    apart = refine("A", poses, registrations, RefineConfig(), linked)
    np.testing.assert_allclose(apart.covariances["B"][:3, :3], 0.5 * one, rtol=0.01, atol=1e-12)


def test_a_link_repeats_no_pair_within_a_stop():
    views = ViewPoses(LIDARS, STRAIGHT, sorted(LIDARS), sorted(STRAIGHT), [sorted(STRAIGHT)])
    every = pairs("A1-B1 A2-B2 A1-B2 A2-B3 A1-A2", stops=STRAIGHT)
    assert [_repeated(each, every, views) for each in every] == pytest.approx([1.0, 1.0, 1.0, 1.0, 0.0])


def test_a_drive_knows_the_stops_of_its_pairs():
    within = _with_systematic_errors(pairs(_WITHIN, stops=STRAIGHT))
    found = refined([*within, *pairs(f"{_LINKS} A1-A3 A2-A4 A1-A4", stops=STRAIGHT)])
    assert len(found.rig.links) == 6
    one = np.linalg.inv(within[0].registration.information)[:3, :3]
    np.testing.assert_allclose(found.rig.covariances["B"][:3, :3], 5.0 / 4.0 * one, rtol=0.1, atol=1e-12)
