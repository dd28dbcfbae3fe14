# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that pairs of its own were accepted for, and the rig refused."""

from __future__ import annotations

import pytest

from multilica.explanation import explain
from tests.sinks.made_documents import made_document
from tests.sinks.made_events import UNPLACED


@pytest.fixture
def accepted():
    """Both pairs of the LiDAR that is not placed are accepted and agree."""
    document = made_document("partial")
    for pair in own_pairs(document):
        pair["verdict"] = {"outcome": "accept", "reasons": []}
    return document


def own_pairs(document):
    return [pair for pair in document["pairs"] if UNPLACED in (pair["target"], pair["source"])]


def missing_of(document):
    (missing,) = explain(document).missing
    return missing


def test_two_pairs_that_put_it_at_different_places_are_both_named_with_the_distance(accepted):
    first, second = own_pairs(accepted)
    second["xyz_m"][0] += 3.0
    second["xyz_m"][1] -= 4.0
    missing = missing_of(accepted)
    assert missing.cause == "two_places"
    assert missing.decisive.sentence.endswith(
        "are each accepted by themselves, and put it at places 5.00 m and 0 deg apart."
    )
    for pair in (first, second):
        assert f"{pair['source']} against {pair['target']} (" in missing.decisive.sentence
    named = [{one.target, one.source} for one in (missing.decisive, missing.elsewhere)]
    assert sorted(named, key=sorted) == sorted(({one["target"], one["source"]} for one in (first, second)), key=sorted)
    assert missing.next_best == "against the rig as merged by then: too little overlap."


@pytest.mark.parametrize(("shift_m", "cause"), [(0.25, "not_in_rig"), (0.35, "two_places")])
def test_places_count_as_two_where_hypotheses_would(accepted, shift_m, cause):
    own_pairs(accepted)[1]["xyz_m"][0] += shift_m
    assert missing_of(accepted).cause == cause


def test_a_pair_that_the_rig_refused_says_what_the_merge_said(accepted):
    missing = missing_of(accepted)
    assert missing.cause == "not_in_rig"
    assert (
        "it was accepted by itself; against the rig as merged by then: too little overlap." in missing.decisive.sentence
    )
    assert missing.elsewhere is None


def test_a_sensor_that_is_not_well_is_named_before_its_places(accepted):
    own_pairs(accepted)[1]["xyz_m"][0] += 5.0
    accepted["lidars"][UNPLACED]["health"] = {"reasons": [{"code": "dirty", "text": "48% of it"}]}
    assert missing_of(accepted).cause == "dirty_sensor"


def test_without_a_merge_step_that_weighed_it_nothing_is_claimed(accepted):
    accepted["decisions"] = []
    missing = missing_of(accepted)
    assert missing.cause == "unknown"
    assert missing.decisive.sentence.endswith("it was accepted by itself.")
