# SPDX-License-Identifier: Apache-2.0
"""An uncertain LiDAR is told with its figure, direction, limit and advice."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from multilica.diagnosis import CAUSES, explain
from multilica.results.values import ONLY_GROUND, ONLY_MOTION
from tests.sinks.made_documents import made_document, parsed
from tests.sinks.made_events import UNPLACED


@pytest.fixture
def document():
    return made_document("uncertain")


def test_the_sigma_above_its_limit_is_told_with_its_direction(document):
    told = explain(parsed(document))
    (uncertain,) = told.uncertain
    assert told.missing == ()
    assert [one.lidar for one in told.placed] == ["front left/1"]
    assert (uncertain.lidar, uncertain.cause, uncertain.direction) == (UNPLACED, "uncertain", "mostly along x of top")
    assert (uncertain.sigma_m, uncertain.max_sigma_m) == (pytest.approx(0.03), 0.02)
    assert uncertain.headline == "rear is uncertain: sigma 30.0 mm mostly along x of top, limit 20 mm."
    assert uncertain.advice == CAUSES["uncertain"][1:]
    assert any("--max-sigma" in advice for advice in uncertain.advice)


def test_a_rotation_above_its_limit_is_told_in_degrees(document):
    covariance = np.diag(np.deg2rad([0.1, 0.1, 0.31]).tolist() + [1e-3] * 3) ** 2
    document["lidars"][UNPLACED]["covariance"] = covariance.tolist()
    (uncertain,) = explain(parsed(document)).uncertain
    assert uncertain.headline == "rear is uncertain: sigma 0.310 deg mostly about z of top, limit 0.2 deg."


@pytest.mark.parametrize("by", [ONLY_MOTION, ONLY_GROUND])
def test_a_pose_that_only_motion_tells_is_told_as_such(document, by):
    """Its sigma may be below the limits, which a higher limit would not change."""
    document["lidars"][UNPLACED]["reason"] = f"{by}: sigma along the axes of top x 5 mm, y 5 mm, z 9 mm"
    (uncertain,) = explain(parsed(document)).uncertain
    assert uncertain.cause == "by_motion"
    assert uncertain.headline == f"rear is uncertain: {document['lidars'][UNPLACED]['reason']}."
    assert not any("--max-sigma" in advice for advice in uncertain.advice)


def test_the_headline_names_uncertain_and_missing_ones():
    document = made_document("uncertain")
    assert explain(parsed(document)).headline == (
        "1 of 3 LiDARs is uncertain. rear: one pose fits, but its sigma is above the limit."
    )
    document["lidars"]["front left/1"] |= {"placed": False, "status": "not_placed", "T_target_source": None}
    document["pairs"] = []
    told = explain(parsed(document))
    assert told.headline.startswith("1 of 3 LiDARs is not placed. front left/1: ")
    assert " 1 of 3 LiDARs is uncertain. rear: " in told.headline
    lines = told.findings
    assert lines[lines.index(told.uncertain[0].headline) + 1].startswith("  What helps: ")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"covariance": None}, "an uncertain LiDAR without a covariance"),
        ({"T_target_source": None}, "a LiDAR that is uncertain without a pose"),
        ({"placed": True}, "`placed` contradicts its `status`"),
    ],
)
def test_a_document_that_contradicts_itself_is_refused(document, change, words):
    document["lidars"][UNPLACED] |= change
    with pytest.raises(ValidationError, match=words):
        parsed(document)


def test_a_pose_that_movable_objects_hold_asks_for_more_frames(document):
    document["lidars"][UNPLACED] |= {"held_by_movable": True, "reason": "objects that can move hold 92 % of it"}
    told = explain(parsed(document))
    (uncertain,) = told.uncertain
    assert uncertain.cause == "held_by_movable"
    assert uncertain.headline.endswith("limit 20 mm. Objects that can move hold 92 % of it.")
    assert uncertain.advice == CAUSES["held_by_movable"][1:]
    assert "--frames" in uncertain.advice[0]
    (warning,) = told.warnings
    assert warning.startswith("rear: only objects that can move hold the pose")


@pytest.mark.parametrize("held", [False, True])
def test_a_contradiction_that_sigma_covers_is_told(document, held):
    cycle = "Top contradicts the other pairs of its cycle by 34 mm"
    document["lidars"][UNPLACED] |= {"held_by_movable": held, "reason": f"cars hold it; sigma covers that {cycle}"}
    (uncertain,) = explain(parsed(document)).uncertain
    why = "Cars hold it. " if held else ""
    assert uncertain.headline.endswith(f"limit 20 mm. {why}Sigma covers that {cycle}.")
    assert uncertain.advice == CAUSES["held_by_movable" if held else "two_places"][1:]


def test_older_documents_have_no_pose_that_movable_objects_hold(document):
    del document["lidars"][UNPLACED]["held_by_movable"]
    assert parsed(document).lidars[UNPLACED].held_by_movable is False
    document["lidars"][UNPLACED]["held_by_movable"] = None
    with pytest.raises(ValidationError, match="held_by_movable"):
        parsed(document)
