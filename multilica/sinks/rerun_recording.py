# SPDX-License-Identifier: Apache-2.0
"""A calibration as a Rerun recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import rerun as rr

from multilica import events
from multilica.sinks.atomic import partial_path
from multilica.sinks.narration import LogLine, cause_of_end, narrate, narrate_end
from multilica.sinks.record_limits import limits_for
from multilica.sinks.rerun_blueprint import final_blueprint, stage_blueprint
from multilica.sinks.rerun_input import log_dropped_table, log_features, log_input, log_preprocessed
from multilica.sinks.rerun_judged import log_beam_labels
from multilica.sinks.rerun_matches import log_matches
from multilica.sinks.rerun_merge import log_merge_step
from multilica.sinks.rerun_outcome import log_ground, log_outcome
from multilica.sinks.rerun_pairs import (
    log_assessments,
    log_contested_places,
    log_hypotheses,
    log_registration,
    show_best_poses,
)
from multilica.sinks.rerun_scene import Scene
from multilica.sinks.rerun_tables import log_pair_tables, log_summary
from multilica.sinks.run_story import RunStory
from multilica.sinks.toml_text import toml_text

__all__ = ["APPLICATION_ID", "RerunRecording"]

APPLICATION_ID = "multilica"
_PROPERTY = "multilica"
_FLUSH_TIMEOUT_S = 60.0
_FLUSH_TICK_S = 7 * 86_400.0


class RerunRecording:
    """A sink that writes every event to a `.rrd` file.

    It is an observer within its `with` block. The file is called `<stem>.partial.rrd` until the calibration has
    finished, and stays so when the run is interrupted or killed: each finished stage is on disk by then.

    Args:
        path: the final name, ending in `.rrd`; what lies there is replaced. How much of the run it holds is said by the
            configuration's section `record`.
        story: shared with other sinks of the run; its own if there are none.
    """

    def __init__(self, path: Path, story: RunStory | None = None) -> None:
        self.path = path
        self._stream = rr.RecordingStream(APPLICATION_ID, send_properties=False, batcher_config=_batching())
        self._scene = Scene(self._stream, story if story is not None else RunStory())

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Record an event; the first one creates the file."""
        scene = self._scene
        if scene.step < 0:
            self._stream.set_sinks(rr.FileSink(partial_path(self.path)))
        scene.story(event)
        scene.advance()
        for line in narrate(event):
            scene.log_line(line)
        handle = _HANDLERS.get(type(event))
        if handle is not None:
            handle(scene, event)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._scene.step < 0:
            return
        whole = self._scene.story.result is not None
        if not whole:
            self._tell_the_end(error)
        _flush(self._stream)
        self._stream.disconnect()
        if whole:
            partial_path(self.path).replace(self.path)

    def _tell_the_end(self, error: BaseException | None) -> None:
        scene = self._scene
        scene.advance()
        scene.log_line(narrate_end(error))
        log_summary(scene, cause_of_end(error))
        _send_properties(scene, "interrupted")
        scene.stream.send_blueprint(stage_blueprint(scene.story))


def _batching() -> rr.ChunkBatcherConfig:
    """Rows are packed by size and at flushes, never by the clock: equal runs make equal files."""
    return rr.ChunkBatcherConfig(flush_tick=_FLUSH_TICK_S)


def _flush(stream: rr.RecordingStream) -> None:
    """Bring to disk what was logged, or say that the disk does not take it."""
    try:
        stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
    except RuntimeError as error:
        raise OSError(f"the recording could not be written: {error}; is the disk full?") from error


def _start(scene: Scene, event: events.CalibrationStarted) -> None:
    scene.limits, share = limits_for(event.config.record, event.snapshot)
    if share < 1.0:
        budget = f"{event.config.record.max_megabytes:g} MB (record.max_megabytes)"
        text = f"recorded is {share:.1%} of the usual points and matches, so that the recording stays below {budget}"
        scene.log_line(LogLine("WARN", text))
    _send_properties(scene, "running")
    log_beam_labels(scene)
    log_input(scene, event)
    log_summary(scene)
    scene.stream.send_blueprint(stage_blueprint(scene.story))
    _flush(scene.stream)


def _finish_stage(scene: Scene, event: events.StageFinished) -> None:
    """Bring to disk what the stage did; a large cloud does not hold back the small rows behind it."""
    if event.stage == "preprocess":
        log_dropped_table(scene)
    if event.stage in ("coarse", "verify", "fine", "merge", "refine"):
        show_best_poses(scene)
        log_pair_tables(scene)
    log_summary(scene)
    if event.stage in ("preprocess", "coarse", "fine", "merge"):
        scene.stream.send_blueprint(stage_blueprint(scene.story))
    _flush(scene.stream)


def _finish(scene: Scene, event: events.CalibrationFinished) -> None:
    log_outcome(scene, event)
    log_contested_places(scene)
    log_summary(scene)
    _send_properties(scene, event.result.status)
    blueprint = final_blueprint if event.result.refusal is None else stage_blueprint
    scene.stream.send_blueprint(blueprint(scene.story))
    _flush(scene.stream)


def _send_properties(scene: Scene, status: str) -> None:
    story = scene.story
    if story.provenance is None or story.config is None:
        return
    values = rr.AnyValues(
        status=status,
        version=story.provenance.versions["multilica"],
        input_source=story.provenance.input["source"],
        input_sha256=story.provenance.input["sha256"],
        config=toml_text(story.config.model_dump(mode="json")),
    )
    scene.stream.send_property(_PROPERTY, values)


_HANDLERS: Mapping[type[events.Event], Callable[[Scene, Any], None]] = {
    events.CalibrationStarted: _start,
    events.CloudPreprocessed: log_preprocessed,
    events.FeaturesComputed: log_features,
    events.CorrespondencesMatched: log_matches,
    events.HypothesesFound: log_hypotheses,
    events.HypothesesAssessed: log_assessments,
    events.PairRegistered: log_registration,
    events.MergeStepTaken: log_merge_step,
    events.GroundEstimated: log_ground,
    events.StageFinished: _finish_stage,
    events.CalibrationFinished: _finish,
}
