# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that a drive does not place, and one that was knocked on the way."""

from dataclasses import replace

import pytest

from multilica.config import CalibrationConfig
from multilica.diagnosis import CAUSES, explain
from multilica.geometry import RigidTransform
from multilica.results import Knock, SnapshotReport, StopLink, TimeLimit
from multilica.results.building import result_document
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.page import report_html
from multilica.sinks.run_state import RunState
from tests.sinks.made_drive import FIRST, LINKS, STOPS
from tests.sinks.made_events import UNPLACED, made_events

LIMIT_M = CalibrationConfig().drive.max_distance_m
TURN = "turn by 60 degrees or more between two stops"
SIGHT = f"add a stop where rear sees what another LiDAR saw at another stop, at most {LIMIT_M:g} m away"
ALONE = "no other link confirms it"
SNAPSHOTS = tuple(SnapshotReport(name, "", f"hash of {name}") for name in (FIRST, "stop_2", "stop_3", "stop_4"))
OF_ONE_LOG = tuple(replace(each, sha256="hash of the log") for each in SNAPSHOTS)
STRAIGHT = tuple(
    replace(stop, T_first_stop=RigidTransform.from_xyz_rpy(FIRST, stop.name, (6.0 * number, 0.0, 0.0), (0.0, 0.0, 0.1)))
    for number, stop in enumerate(STOPS)
)
OF_OTHERS = LINKS[:2]


def document_of(links=OF_OTHERS, stops=STOPS, outcome="partial", snapshots=SNAPSHOTS, **changes):
    state = RunState()
    for event in made_events(outcome):
        state(event)
    result = replace(state.result, links=links, stops=stops, snapshots=snapshots, **changes)
    return result_document(result, state.config, state.provenance)


def missing_of(*args, **kwargs):
    (missing,) = explain(document_of(*args, **kwargs)).missing
    return missing


def link(target, target_stop, source, source_stop, reason=ALONE):
    return StopLink(target, target_stop, source, source_stop, 3.0, used=not reason, reason=reason)


def test_a_lidar_that_no_stop_links_needs_sight_of_another():
    missing = missing_of()
    assert (missing.lidar, missing.by_stop) == (
        UNPLACED,
        "none of 4 stops sees it linked with another stop. The linked stops turn by at most 115 degrees.",
    )
    assert missing.advice[0] == SIGHT
    assert f"By stop: {missing.by_stop}" in missing.details
    assert f"What helps: {SIGHT}." in missing.details


def test_a_lidar_without_time_for_its_links_needs_time():
    missing = missing_of(pairs=(), time_limit=TimeLimit(1.0, (), (("stop_2", "stop_3"),)))
    assert (missing.cause, missing.by_stop) == ("out_of_time", "Not all links with other stops were sought.")
    assert missing.advice == CAUSES["out_of_time"][1:]


def test_a_straight_drive_has_to_turn():
    missing = missing_of(stops=STRAIGHT)
    assert missing.by_stop.endswith("The linked stops turn by at most 0 degrees.")
    assert missing.advice[:2] == (TURN, SIGHT)


def test_links_of_a_lidar_with_itself_tell_its_motion_alone():
    missing = missing_of((*OF_OTHERS, link("rear", "stop_3", "rear", FIRST)))
    assert missing.by_stop.startswith(
        "2 of 4 stops see it linked with another stop: stop_1, stop_3. Links that count: 0 of 1. "
        f"The others do not: {ALONE} (1). All its links are with itself:"
    )
    assert missing.advice[0] == SIGHT


def test_a_link_that_nothing_confirms_needs_a_stop_nearby():
    elsewhere = link("rear", "stop_4", "top", FIRST, "it contradicts other links and pairs")
    own = (link("top", FIRST, "rear", "stop_3"), elsewhere, link("rear", FIRST, "rear", "stop_3", ""))
    missing = missing_of((*OF_OTHERS, *own))
    assert missing.by_stop.startswith(
        "3 of 4 stops see it linked with another stop: stop_1, stop_3, stop_4. Links that count: 1 of 3. "
        f"The others do not: {ALONE} (1); it contradicts other links and pairs (1). The linked"
    )
    assert missing.advice[0] == (
        "add a stop near stop_3 or stop_4 where rear sees the same again: a link counts only if others confirm it"
    )


def test_a_log_whose_stops_nothing_links_is_a_drive():
    missing = missing_of((), (), snapshots=OF_ONE_LOG)
    assert missing.by_stop == "none of 4 stops sees it linked with another stop."
    assert missing.advice[:2] == (TURN, SIGHT)


def test_snapshots_of_different_places_are_no_drive():
    assert not missing_of((), ()).by_stop
    assert TURN not in missing_of((), ()).advice


def test_a_dead_lidar_needs_no_other_stop():
    document = document_of().model_dump(mode="json")
    reason = {"code": "dead", "value": 1.0, "limit": 2.0, "text": "it returned nothing"}
    document["lidars"][UNPLACED]["health"] = {
        "returns": 0,
        "near_share": 0.0,
        "blockage_ratio": 0.0,
        "reasons": [reason],
    }
    (missing,) = explain(type(document_of()).model_validate(document)).missing
    assert (missing.cause, missing.by_stop) == ("dead_sensor", "")


@pytest.mark.parametrize("outcome", ["complete", "partial"])
def test_each_knock_has_a_sentence(outcome):
    knocks = (Knock("rear", FIRST, "stop_2", 0.021, 0.1, (FIRST,)), Knock("top", "stop_2", "stop_3", 0.3, 2.0, ()))
    told = explain(document_of(outcome=outcome, knocks=knocks))
    assert told.warnings[0] == (
        "rear moved by 21 mm, 0.10 deg between stop_1 and stop_2; the pose of rear is the one without stop_1. "
        "Check how rear is fastened, then calibrate again."
    )
    assert [warning.split()[0] for warning in told.warnings] == ["rear", "top"]


def test_the_report_tells_stops_and_knocks():
    document = document_of(knocks=(Knock("top", FIRST, "stop_2", 0.021, 0.1, (FIRST,)),))
    page = report_html(ReportContents(document, {}))
    assert f"<dt>By stop</dt><dd>{missing_of().by_stop}</dd>" in page
    assert page.count("top moved by 21 mm") == 1
