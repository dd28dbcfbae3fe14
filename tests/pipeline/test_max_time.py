# SPDX-License-Identifier: Apache-2.0
"""A calibration whose time is over ends with what it has."""

from dataclasses import replace

import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.diagnosis import explain
from multilica.orchestration import search
from multilica.orchestration.pairs import search_pair
from multilica.orchestration.state import CalibrationState
from multilica.results import TimeLimit
from multilica.results.building import provenance_of, result_document
from tests.pipeline.watched import assert_true, only, sides, watched

pytestmark = pytest.mark.slow

CONFIG = with_overrides(CalibrationConfig(), ["runtime.max_time_s=600.0", "runtime.workers=1", "target=top"])


def _ends_after(monkeypatch: pytest.MonkeyPatch, questions: int) -> None:
    """Let the time be over after so many looks at the clock."""
    asked = iter(range(10_000))
    monkeypatch.setattr(CalibrationState, "out_of_time", property(lambda _: next(asked) >= questions))


def test_what_is_not_reached_is_told(monkeypatch):
    _ends_after(monkeypatch, 0)
    snapshot = only(sides().snapshot, "left", "right", "top", every=4)
    result, _ = watched(snapshot, base=CONFIG)
    assert result.time_limit == TimeLimit(600.0, (("left", "right"), ("left", "top"), ("right", "top")))
    assert (result.status, result.pairs) == ("failed", ())
    assert (
        result["left"].reason
        == "the time limit (--max-time) ended the search before its pairs with right, top were searched"
    )
    document = result_document(result, CONFIG, provenance_of(snapshot))
    explanation = explain(document)
    assert [missing.cause for missing in explanation.missing] == ["out_of_time"] * 2
    assert "left - right, left - top, right - top" in explanation.warnings[0]


@pytest.mark.parametrize("compared", [False, True])
def test_a_lone_pair_counts_if_the_third_was_compared(monkeypatch, compared):
    def some_only(lidars, request):
        if request.pair == ("left", "top"):
            return search_pair(lidars, request)
        if compared and request.pair == ("right", "top"):
            return replace(search_pair(lidars, request), verified=(), registration=None)
        return None

    monkeypatch.setattr(search, "search_pair", some_only)
    result, _ = watched(sides().snapshot, base=CONFIG)
    assert result["left"].placed is compared
    assert result["right"].T_target_source is None
    assert {name for pair in result.time_limit.not_reached for name in pair} >= {"left", "right"}
    if not compared:
        document = result_document(result, CONFIG, provenance_of(sides().snapshot))
        assert [missing.cause for missing in explain(document).missing] == ["out_of_time"] * 2


@pytest.mark.in_turn
def test_a_limit_that_is_not_reached_changes_nothing():
    snapshot = only(sides().snapshot, "left", "right", "top", every=2)
    result, _ = watched(snapshot, base=CONFIG)
    unlimited, _ = watched(snapshot, base=with_overrides(CONFIG, ["runtime.max_time_s=0.0"]))
    assert (result.time_limit, result.status) == (None, "complete")
    assert_true(result, sides().truth)
    for one, other in zip(result.placements, unlimited.placements, strict=True):
        assert one.T_target_source.matrix.tobytes() == other.T_target_source.matrix.tobytes()
