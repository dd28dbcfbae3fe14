# SPDX-License-Identifier: Apache-2.0
"""The result document of a run, whether it has ended or not."""

from multilica.results import CalibrationResult, LidarPlacement
from multilica.results.document.building import result_document
from multilica.results.document.result import ProgressEntry, ResultDocument
from multilica.sinks.run_state import RunState
from multilica.sinks.text.stage_figures import stage_figures


def run_document(state: RunState) -> ResultDocument | None:
    """Return what is known of a run so far, with progress and figures per stage; None before it has started.

    Sinks that share a state share the document.
    """
    if state.document is None and state.config is not None and state.provenance is not None:
        document = result_document(result_so_far(state), state.config, state.provenance)
        running = state.stage if state.stage not in state.stages else None
        known = {
            "progress": ProgressEntry(finished=tuple(state.stages), running=running),
            "stages": stage_figures(state),
        }
        state.document = document.model_copy(
            update=known if state.result is not None else {"status": "unfinished", **known}
        )
    return state.document


def result_so_far(state: RunState) -> CalibrationResult:
    """Return the result, or what is known of it; before the end no LiDAR counts as placed."""
    if state.result is not None:
        return state.result
    target = state.target or (state.config.target if state.config is not None else "")
    return CalibrationResult(
        target=target,
        target_reason=state.target_reason or "not chosen yet",
        placements=tuple(LidarPlacement(name, reason="the run ended before it was placed") for name in state.lidars),
        pairs=tuple(state.registrations.values()),
        decisions=tuple(state.decisions),
        health=tuple(cloud.health for cloud in state.clouds.values() if cloud.health is not None),
    )
