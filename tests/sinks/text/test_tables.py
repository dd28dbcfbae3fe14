# SPDX-License-Identifier: Apache-2.0
"""Numbers in the tables of a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.results.visibility_score import VisibilityScore
from multilica.sinks.run_state import RunState
from multilica.sinks.text.pair_tables import hypotheses_markdown, pair_scores_markdown
from tests.sinks.made_events import made_events


@pytest.fixture
def without_evidence() -> RunState:
    """A run of which no pose has any evidence, but for rounding."""
    score = VisibilityScore(5, 0, 0, 0, np.diag([0.0, 0.0, 0.0, 5.0 + 1e-12, 0.0, 0.0]), np.zeros(0, dtype=np.uint8))
    state = RunState()
    for event in made_events():
        if isinstance(event, events.PairRegistered):
            continue
        state(event)
        if isinstance(event, events.HypothesesVerified):
            pair = (event.target, event.source)
            state.verified[pair] = tuple(replace(one, visibility=score) for one in state.verified[pair])
    return state


def test_no_evidence_has_no_sign(without_evidence):
    for pair, verified in without_evidence.verified.items():
        assert all(-1e-9 < one.evidence < 1e-9 for one in verified)
        assert "| -0 |" not in pair_scores_markdown(without_evidence, pair, None, {})
    text = hypotheses_markdown(without_evidence)
    assert "| 0 |" in text
    assert "| -0 |" not in text
