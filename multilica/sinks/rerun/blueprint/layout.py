# SPDX-License-Identifier: Apache-2.0
"""Blueprints of the viewer."""

import rerun.blueprint as rrb

from multilica.sinks.rerun.blueprint.failure_tab import failure_tab
from multilica.sinks.rerun.blueprint.result_tab import result_tab
from multilica.sinks.rerun.blueprint.stage_tabs import stage_tab, stage_tabs
from multilica.sinks.rerun.blueprint.views import document_view, log_view, summary_view
from multilica.sinks.rerun.scene import STEP_TIMELINE
from multilica.sinks.rerun.tree import CONFIG
from multilica.sinks.run_state import RunState

__all__ = ["final_blueprint", "stage_blueprint"]


def stage_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the last finished stage, for a recording that ends there."""
    stage = state.stages[-1] if state.stages else "ingest"
    side = rrb.Vertical(summary_view(), log_view(), row_shares=[1, 1])
    return _blueprint(rrb.Horizontal(stage_tab(state, stage), side, column_shares=[2, 1]))


def final_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the result, or the pair that failed, then a tab per stage."""
    stages = stage_tabs(state)
    last = rrb.Horizontal(
        log_view("All lines", ("DEBUG", "INFO", "WARN", "ERROR")), document_view(CONFIG, "Config"), name="Log"
    )
    first = [tab for tab in (failure_tab(state), result_tab(state)) if tab is not None]
    opened = 0 if first else len(stages) - 1
    return _blueprint(rrb.Tabs(*first, *stages, last, active_tab=opened))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    time_panel = rrb.TimePanel(state="collapsed", timeline=STEP_TIMELINE, play_state="following")
    return rrb.Blueprint(
        root, time_panel, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"), auto_views=False
    )
