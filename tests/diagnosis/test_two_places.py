# SPDX-License-Identifier: Apache-2.0
"""LiDARs with accepted pairs that are not placed."""

from __future__ import annotations

import pytest

from multilica.diagnosis import explain
from tests.sinks.made_documents import made_document, parsed
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


def contest(document):
    """Say that the two pairs put the LiDAR at places 5 m apart."""
    names = [(pair["target"], pair["source"]) for pair in own_pairs(document)]
    document["lidars"][UNPLACED]["contested"] = {
        "pair": names[0],
        "other": names[1],
        "distance_m": 5.0,
        "angle_deg": 0.0,
    }


def missing_of(document):
    (missing,) = explain(parsed(document)).missing
    return missing


def test_contested_pairs_are_named_with_the_distance(accepted):
    contest(accepted)
    missing = missing_of(accepted)
    assert missing.cause == "two_places"
    assert missing.decisive.sentence.endswith("are each accepted, but place it 5.00 m and 0 deg apart.")
    for pair in own_pairs(accepted):
        assert f"{pair['source']} against {pair['target']} (" in missing.decisive.sentence
    first, other = own_pairs(accepted)
    assert (missing.decisive.target, missing.decisive.source) == (first["target"], first["source"])
    assert (missing.elsewhere.target, missing.elsewhere.source) == (other["target"], other["source"])
    assert missing.next_best == "Against the merged rig: too little evidence."


def test_pair_refused_by_the_merge_gives_its_reason(accepted):
    missing = missing_of(accepted)
    assert missing.cause == "not_in_rig"
    assert "the pair itself was accepted. Against the merged rig: too little evidence." in missing.decisive.sentence
    assert missing.elsewhere is None


def test_sensor_fault_comes_before_contested_places(accepted):
    contest(accepted)
    dirty = {"code": "dirty", "value": 0.48, "limit": 0.1, "text": "48% of it"}
    accepted["lidars"][UNPLACED]["health"] = {
        "returns": 9,
        "near_share": 0.0,
        "blockage_ratio": 0.5,
        "reasons": [dirty],
    }
    assert missing_of(accepted).cause == "dirty_sensor"


def test_without_a_merge_step_the_cause_is_unknown(accepted):
    accepted["decisions"] = []
    missing = missing_of(accepted)
    assert missing.cause == "unknown"
    assert missing.decisive.sentence.endswith("the pair itself was accepted.")
