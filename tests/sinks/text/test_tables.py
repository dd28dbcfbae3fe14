# SPDX-License-Identifier: Apache-2.0
"""Numbers in the tables of a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results.visibility_score import DISTINCTIVE_WEIGHT, PRIOR_LOG_ODDS, VisibilityScore
from multilica.sinks.run_state import RunState
from multilica.sinks.text.markdown import hypotheses_markdown, pair_scores_markdown
from tests.sinks.made_events import made_events


@pytest.fixture
def without_evidence() -> RunState:
    """A run of which every pose is as likely as not, but for rounding."""
    on_the_ground = 50.0 - np.expm1((-0.02 - PRIOR_LOG_ODDS) / DISTINCTIVE_WEIGHT)
    information = np.diag([0.0, 0.0, 0.0, on_the_ground, 0.0, 0.0])
    score = VisibilityScore(50, 0, 0, 0, information, np.zeros(0, dtype=np.uint8))
    state = RunState()
    for event in made_events():
        if isinstance(event, events.PairRegistered):
            continue
        state(event)
        if isinstance(event, events.HypothesesVerified):
            pair = (event.target, event.source)
            here = RigidTransform.identity(*pair)
            scored = (replace(one, visibility=score, T_target_source=here) for one in state.verified[pair])
            state.verified[pair] = tuple(scored)
    return state


def test_no_evidence_has_no_sign(without_evidence):
    for pair, verified in without_evidence.verified.items():
        assert all(-0.05 < one.evidence < 0.0 for one in verified)
        assert "| -0.0 |" not in pair_scores_markdown(without_evidence, pair, None, {})
    text = hypotheses_markdown(without_evidence)
    assert "| 0.0 |" in text
    assert "| -0.0 |" not in text
