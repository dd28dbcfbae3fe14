# SPDX-License-Identifier: Apache-2.0
"""The result document of a run, whether it has ended or not."""

from __future__ import annotations

from typing import Any

from multilica.results import CalibrationResult, LidarPlacement
from multilica.sinks.result_document import json_safe, result_document
from multilica.sinks.run_story import RunStory
from multilica.sinks.stage_figures import stage_figures

__all__ = ["UNFINISHED", "result_so_far", "run_document"]

UNFINISHED = "unfinished"
"""Status in the recording of a run that was cut off; `result.json` never has it."""


def run_document(story: RunStory) -> dict[str, Any] | None:
    """What is known of a run so far, in the form of `result.json`; None before it has started.

    Beyond `result_document` it holds `progress`, the stages that finished and the one that runs, and `stages`, the
    figures of each. The sinks that share a story share the document: it is not to be changed.
    """
    if story.document is None:
        story.document = _document(story)
    return story.document


def _document(story: RunStory) -> dict[str, Any] | None:
    if story.config is None or story.provenance is None:
        return None
    result = result_so_far(story)
    document = result_document(result, story.config, story.provenance)
    if story.result is None:
        document["status"] = UNFINISHED
    running = story.stage if story.stage not in story.stages else None
    document["progress"] = {"finished": list(story.stages), "running": running}
    document["stages"] = json_safe(stage_figures(story))
    return document


def result_so_far(story: RunStory) -> CalibrationResult:
    """The result, or what is known of it: nothing is placed before the end, for a merge may yet be adjusted."""
    if story.result is not None:
        return story.result
    target = story.target or (story.config.target if story.config is not None else "")
    return CalibrationResult(
        target=target,
        target_reason=story.target_reason or "not chosen yet",
        placements=tuple(LidarPlacement(name, reason="the run ended before it was placed") for name in story.lidars),
        pairs=tuple(story.registrations.values()),
        decisions=tuple(story.decisions),
        health=tuple(cloud.health for cloud in story.clouds.values() if cloud.health is not None),
    )
