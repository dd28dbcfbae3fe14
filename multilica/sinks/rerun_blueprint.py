# SPDX-License-Identifier: Apache-2.0
"""What the viewer opens on."""

from __future__ import annotations

import rerun.blueprint as rrb

from multilica.sinks.rerun_failure_view import failure_tab
from multilica.sinks.rerun_result_view import result_tab
from multilica.sinks.rerun_scene import STEP_TIMELINE
from multilica.sinks.rerun_stage_tabs import stage_tab, stage_tabs
from multilica.sinks.rerun_tree import CONFIG
from multilica.sinks.rerun_views import document_view, log_view, summary_view
from multilica.sinks.run_story import RunStory

__all__ = ["final_blueprint", "stage_blueprint"]


def stage_blueprint(story: RunStory) -> rrb.Blueprint:
    """While the run goes on: the last finished stage, for a recording that ends there."""
    stage = story.stages[-1] if story.stages else "ingest"
    side = rrb.Vertical(summary_view(), log_view(), row_shares=[1, 1])
    return _blueprint(rrb.Horizontal(stage_tab(story, stage), side, column_shares=[2, 1]))


def final_blueprint(story: RunStory) -> rrb.Blueprint:
    """The whole run: first the result, or the comparison that failed, then a tab per stage."""
    stages = stage_tabs(story)
    last = rrb.Horizontal(
        log_view("All lines", ("DEBUG", "INFO", "WARN", "ERROR")), document_view(CONFIG, "Config"), name="Log"
    )
    first = [tab for tab in (failure_tab(story), result_tab(story)) if tab is not None]
    opened = 0 if first else len(stages) - 1
    return _blueprint(rrb.Tabs(*first, *stages, last, active_tab=opened))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    time_panel = rrb.TimePanel(state="collapsed", timeline=STEP_TIMELINE, play_state="following")
    return rrb.Blueprint(
        root, time_panel, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"), auto_views=False
    )
