# SPDX-License-Identifier: Apache-2.0
"""Links far from the others, and pairs of one stop that beams of others contradict."""

import numpy as np
import pytest

from multilica.config import RefineConfig
from multilica.multi_snapshot.trusted_links import refine_linked
from tests.multi_snapshot.made_drive import LIDARS, SIGMA, STOPS, STRAIGHT, pair, pairs

_GOOD = "A1-A2 A2-A3 A1-B2 A2-B1 A2-B3 A3-B2 B1-B2 B2-B3"


def _refined(links):
    return refine_linked("A", dict.fromkeys(STOPS, ()), links, RefineConfig())


def _error(found):
    return found.rig.poses["B"].offset_from(LIDARS["B"])


_FAR = [0.0, 0.0, 0.0, 8.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("text", "odd", "stops"),
    [
        ("A1-A2 A2-A3 A1-B2 A2-B1 A2-B3", "A1-A3", STOPS),
        (_GOOD, "A1-A3 A3-B1", STOPS),
        (_GOOD, "A1-A3", STRAIGHT),
        ("A1-A2 A1-B2 A2-B1 B1-B2 A2-A3 B3-C3 C1-C2", "A3-B1", STOPS),
    ],
    ids=["few others", "two", "straight on", "either may be wrong"],
)
def test_a_link_far_from_the_others_shows_a_look_alike(text, odd, stops):
    rng = np.random.default_rng(5)
    far = [pair(*each.split("-"), rng, off=_FAR, stops=stops) for each in odd.split()]
    found = _refined([*pairs(text, rng, stops=stops), *far])
    assert not found.rig.stops
    assert all("looks like another" in link.reason for link in found.links)


@pytest.mark.parametrize("alone", ["", " A2-C3"], ids=["all confirmed", "one that nothing confirms"])
def test_one_far_link_of_many_goes_alone(alone):
    rng = np.random.default_rng(5)
    found = _refined([*pairs(_GOOD + alone, rng), pair("A1", "A3", rng, off=_FAR)])
    reasons = [link.reason for link in found.links if not link.used]
    assert reasons == ["all other links put it elsewhere", *(["no other link confirms it"] if alone else [])]
    assert np.all(np.abs(_error(found)) < 5.0 * SIGMA)


def test_links_that_do_not_fit_stand_against_none():
    rng = np.random.default_rng(5)
    apart = pair("B1", "A3", rng, off=[0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    found = _refined([*pairs(_GOOD, rng), apart, pair("A1", "A3", rng, off=_FAR)])
    assert not found.rig.stops


def test_a_wrong_pair_of_one_stop_leaves_the_links():
    """Beams of another stop contradict it, and the links that it contradicted confirm each other."""
    links = pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8))
    wrong = pair("A2", "B2", off=[0.0, 0.0, 0.6, 3.0, 0.0, 0.0]).registration
    within = {**dict.fromkeys(STOPS, ()), "stop 2": (wrong,)}

    def against(pose, own):
        return "stop 1" if pose.distance_to(LIDARS["B"])[0] > 0.1 and "stop 1" not in own else ""

    found = refine_linked("A", within, links, RefineConfig(), against)
    assert [conflict.source for conflict in found.conflicts] == ["B"]
    assert not found.within
    assert sum(link.used for link in found.links) == 6
    assert np.all(np.abs(_error(found)) < 5.0 * SIGMA)


def test_pairs_within_a_stop_stay_where_lidars_are_far_apart():
    """A chain of pairs may be longer than any pair; only links may put LiDARs too far apart."""
    links = pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8))
    own = (pair("A1", "B1").registration,)
    within = {**dict.fromkeys(STOPS, ()), "stop 1": own}
    found = refine_linked("A", within, links, RefineConfig(), max_baseline_m=1.2)
    assert [each.registration for each in found.within] == [*own]
    assert all("farther from A than" in link.reason for link in found.links)
