# SPDX-License-Identifier: Apache-2.0
"""One verdict over the stops of a vehicle."""

from __future__ import annotations

import pytest

from multilica.checks import LidarCheck, RigCheck, check_document, settle_stops, without_common_view
from multilica.checks.ci_reports import junit_xml, summary_markdown, word_of


def stop(name: str, root: str = "top", **verdicts: str) -> RigCheck:
    lidars = tuple(
        LidarCheck(lidar=lidar, verdict=verdict, reason="so it is", max_translation_m=0.03, max_rotation_deg=0.3)
        for lidar, verdict in verdicts.items()
    )
    return RigCheck(name=name, root=root, lidars=lidars)


def verdicts_of(checks: tuple[RigCheck, ...]) -> list[dict[str, str]]:
    return [{each.lidar: each.verdict for each in check.lidars} for check in checks]


def test_a_stop_that_decides_settles_the_others() -> None:
    checks = settle_stops([stop("one", left="undecided", right="within"), stop("two", left="within", right="within")])
    assert verdicts_of(checks) == [{"left": "within", "right": "within"}] * 2
    assert checks[0].lidars[0].reason == "so it is at two; here: so it is"
    assert check_document(checks, "reference").sentence == "All LiDARs agree with the reference."


def test_the_root_of_a_stop_is_within_there() -> None:
    checks = settle_stops([stop("one", "left", top="within"), stop("two", left="undecided")])
    assert verdicts_of(checks)[1] == {"left": "within"}
    assert "others are compared to it at one" in checks[1].lidars[0].reason


def test_a_stop_that_measured_nothing_says_so() -> None:
    found = stop("all", front="within")
    found = found.model_copy(update={"lidars": (found.lidars[0].model_copy(update={"distance_m": 0.01}),)})
    checks = settle_stops([found, stop("one", front="undecided"), stop("two", "front", top="undecided")])
    assert [check.verdict for check in checks] == ["within"] * 3
    assert [check.sentence for check in checks] == [
        "All 2 LiDARs agree with the reference.",
        "front was not measured here.",
        "top was not measured here.",
    ]
    assert [word_of(check.lidars[0]) for check in checks] == ["within", "not measured", "not measured"]
    assert junit_xml(checks, "2026-11-23T03:00:00").count("<skipped />") == 2
    row = next(line for line in summary_markdown(checks[1:2], "reference").splitlines() if line.startswith("| front"))
    assert row.startswith("| front | not measured | - | - | - | so it is at all; here: so it is |")


def test_groups_that_no_stop_compares_do_not_settle_each_other() -> None:
    """The rear pair may have moved as a whole."""
    front = stop("one", "front_left", front_right="within", rear_left="undecided", rear_right="undecided")
    rear = stop("two", "rear_left", rear_right="within", front_right="undecided")
    assert verdicts_of(settle_stops([front, rear])) == verdicts_of((front, rear))
    both = stop("three", "rear_right", front_right="within")
    assert {check.verdict for check in settle_stops([front, rear, both])} == {"within"}


@pytest.mark.parametrize(
    ("distance_m", "probability", "verdict"),
    [(0.065, 0.005, "undecided"), (0.065, 0.02, "within"), (0.02, 0.005, "within"), (None, None, "within")],
)
def test_a_stop_that_measured_a_motion_is_not_settled(distance_m, probability, verdict) -> None:
    later = stop("two", left="undecided")
    measured = {"distance_m": distance_m, "translation_probability": probability}
    later = later.model_copy(update={"lidars": (later.lidars[0].model_copy(update=measured),)})
    assert settle_stops([stop("one", left="within"), later])[1].verdict == verdict


def test_what_moved_later_stays_outside() -> None:
    checks = settle_stops([stop("one", left="within"), stop("two", left="outside"), stop("three", left="undecided")])
    assert verdicts_of(checks) == [{"left": "within"}, {"left": "outside"}, {"left": "within"}]
    document = check_document(checks, "reference")
    assert (document.verdict, document.sentence) == ("outside", "two: left is outside.")


def test_what_no_stop_decides_is_undecided() -> None:
    checks = settle_stops([stop("one", left="undecided", right="undecided"), stop("two", left="undecided")])
    assert check_document(checks, "reference").verdict == "undecided"


def test_lidars_without_a_common_view_are_left_to_check() -> None:
    reason = "not placed: it shares too few surfaces with top"
    checks = [stop("one", left="undecided", right="undecided"), stop("two", left="undecided", right="within")]
    blind = [
        check.model_copy(update={"lidars": tuple(each.model_copy(update={"reason": reason}) for each in check.lidars)})
        for check in checks
    ]
    left, right = without_common_view(blind)[0].lidars
    assert left.reason.startswith(f"{reason}; no stop has a common view, and `multilica check` on the log compares")
    assert right.reason == reason
    assert without_common_view(blind[:1]) == (blind[0],)
    assert without_common_view(checks) == tuple(checks)
