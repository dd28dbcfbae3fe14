# SPDX-License-Identifier: Apache-2.0
"""result.mcap in Foxglove Studio."""

from __future__ import annotations

import time

import pytest

from multilica.sinks.drawing import distinct_colours
from multilica.sinks.mcap.result_mcap import ResultMcap
from tests.selection import RUN_FILES
from tests.sinks.made_events import LIDARS, UNPLACED, made_events
from tests.sinks.mcap.studio import has_studio, served_studio

pytestmark = [
    pytest.mark.slow,
    pytest.mark.shows(*RUN_FILES),
    pytest.mark.skipif(not has_studio(), reason="run: npm install --prefix tests/node --no-package-lock"),
]
DRAWN_S = 60.0
MIN_PIXELS = 30


@pytest.mark.parametrize(
    ("encoding", "outcome"),
    [
        ("foxglove", "complete"),
        ("ros2", "partial"),
        pytest.param("foxglove", "partial", marks=pytest.mark.nightly),
        pytest.param("ros2", "complete", marks=pytest.mark.nightly),
    ],
)
def test_placed_clouds_are_drawn_without_a_problem(tmp_path, browser, encoding, outcome):
    with ResultMcap(tmp_path / "result.mcap", encoding) as observe:
        for event in made_events(outcome, at_stops=True):
            observe(event)
    with served_studio(browser, tmp_path) as open_studio:
        studio = open_studio()
        studio.await_metrics(outcome)
        colours = distinct_colours(LIDARS)
        placed = [name for name in LIDARS if outcome == "complete" or name != UNPLACED]
        deadline = time.monotonic() + DRAWN_S
        while not all(studio.pixels_of(colours[name]) > MIN_PIXELS for name in placed):
            assert time.monotonic() < deadline, {name: studio.pixels_of(colours[name]) for name in LIDARS}
            studio.page.wait_for_timeout(500)
        assert studio.complaints == []
