# SPDX-License-Identifier: Apache-2.0
"""Sink that writes a Rerun recording."""

import ctypes
import errno
import os
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings

from multilica import events
from multilica.sinks.files.atomic import partial_path
from multilica.sinks.files.result_files import config_toml
from multilica.sinks.rerun import pairs, tables
from multilica.sinks.rerun.blueprint import final_blueprint, stage_blueprint
from multilica.sinks.rerun.drive import log_drive
from multilica.sinks.rerun.lidars import (
    log_dropped_table,
    log_features,
    log_ground,
    log_input,
    log_merge_step,
    log_movable,
    log_outcome,
    log_preprocessed,
    log_refused,
    log_residuals,
)
from multilica.sinks.rerun.scene import RerunScene, limits_for
from multilica.sinks.rerun.tables import log_data_tables, log_pair_tables, log_summary
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine, cause_of_end, log_end, log_lines

_NAME = "multilica"
# A slow disk still writes some bytes in this time.
_SILENCE_S, _GLANCE_S = 20.0, 0.5
_FLUSH_TICK_S = 7 * 86_400.0


def send_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """Send a blueprint as `stream.send_blueprint` does, and disconnect the stream that it is made with.

    Rerun keeps that one with its two threads for the life of the process.
    """
    native = bindings.new_blueprint(
        application_id=rr.get_application_id(recording=stream) or "",
        make_default=False,
        make_thread_default=False,
        default_enabled=True,
    )
    made = rr.RecordingStream._from_native(native)  # noqa: SLF001
    made.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(made)  # noqa: SLF001
    held = made.memory_recording()
    bindings.send_blueprint(held.storage, make_active=True, make_default=True, recording=stream.to_native())
    made.disconnect()


class RerunRecording(AbstractContextManager["RerunRecording"]):
    """A sink that writes every event to a `.rrd` file.

    Use it as an observer within its `with` block. The file is `<stem>.partial.rrd` until the calibration finishes, also
    after an interrupted or killed run. Each finished stage is on disk. An existing file is replaced.
    """

    def __init__(self, path: Path, state: RunState | None = None) -> None:
        self.path = path
        # In batches by size and at flushes, never by the clock: equal runs make equal files.
        batches = rr.ChunkBatcherConfig(flush_tick=_FLUSH_TICK_S)
        self._stream = rr.RecordingStream(_NAME, send_properties=False, batcher_config=batches)
        self._scene = RerunScene(self._stream, state or RunState(), partial_path(path))

    def __call__(self, event: events.Event) -> None:
        """Record an event; the first one creates the file."""
        scene = self._scene
        if scene.step < 0:
            self._stream.set_sinks(rr.FileSink(scene.file))
        scene.state(event)
        scene.advance()
        for line in log_lines(event):
            scene.log_line(line)
        for handle in _HANDLERS.get(type(event), ()):
            handle(scene, event)

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if self._scene.step < 0 or self._scene.is_abandoned:
            return
        whole = self._scene.state.result is not None
        if not whole:
            self._scene.advance()
            self._scene.log_line(log_end(error))
            log_summary(self._scene, cause_of_end(error))
            _send_properties(self._scene, "interrupted")
            send_blueprint(self._stream, stage_blueprint(self._scene.state))
        _flush(self._scene)
        self._stream.disconnect()
        if whole:
            self._scene.file.replace(self.path)
        del self._stream, self._scene
        bindings.flush_and_cleanup_orphaned_recordings()  # ends the threads of streams that nothing refers to


def _flush(scene: RerunScene, _event: events.Event | None = None) -> None:
    """Wait until all is on disk.

    Raises:
        OSError: it cannot be written, because the disk is full for example. The stream is abandoned.
    """
    size, since_s = -1, time.monotonic()
    while True:
        begun_s = time.monotonic()
        try:
            scene.stream.flush(timeout_sec=_GLANCE_S)
        except RuntimeError as error:
            now_s, written = time.monotonic(), scene.file.stat().st_size
            has_ended = now_s - begun_s < 0.5 * _GLANCE_S  # it did not wait
            is_full = shutil.disk_usage(scene.file.parent).free == 0
            if not has_ended and written > size:
                size, since_s = written, now_s
                continue
            if not (has_ended or is_full or now_s - since_s > _SILENCE_S):
                continue
            _abandon(scene)
            code = errno.ENOSPC if is_full else errno.EIO
            raise OSError(code, os.strerror(code), str(scene.file)) from error
        return


def _abandon(scene: RerunScene) -> None:
    """Never end a stream whose writer has ended: Rerun would wait for it forever, at its shutdown too."""
    scene.is_abandoned = True
    rr.unregister_shutdown()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(scene.stream))  # or its end would come with that of the process


def _start(scene: RerunScene, event: events.CalibrationStarted) -> None:
    scene.plan = limits_for(event.config.record, event.snapshot, len(event.stops))
    if scene.plan.share < 1.0:
        budget = f"{event.config.record.max_megabytes:g} MB (record.max_megabytes)"
        text = f"recording {scene.plan.share:.1%} of the usual points and matches to stay below {budget}"
        scene.log_line(LogLine("WARN", text))
    _send_properties(scene, "running")
    log_input(scene, event)
    log_summary(scene)
    send_blueprint(scene.stream, stage_blueprint(scene.state))
    _flush(scene)


def _finish_stage(scene: RerunScene, event: events.StageFinished) -> None:
    """Log the tables and write the stage to disk, with the last one of stages that ran together."""
    if event.stage != scene.state.stage:
        return
    if event.stage == "preprocess":
        log_dropped_table(scene)
    if event.stage in ("coarse", "verify", "fine", "merge", "refine"):
        pairs.show_best_poses(scene)
        log_pair_tables(scene)
        log_data_tables(scene)
    log_summary(scene)
    if event.stage in ("preprocess", "coarse", "verify", "fine", "merge"):
        send_blueprint(scene.stream, stage_blueprint(scene.state))
    _flush(scene)


def _finish(scene: RerunScene, event: events.CalibrationFinished) -> None:
    if event.result.refusal is not None:
        log_refused(scene)
    log_outcome(scene)
    pairs.log_contested_places(scene)
    log_data_tables(scene)
    tables.log_timings(scene)
    log_summary(scene)
    _send_properties(scene, event.result.status)
    blueprint = final_blueprint if event.result.refusal is None else stage_blueprint
    send_blueprint(scene.stream, blueprint(scene.state))
    _flush(scene)


def _send_properties(scene: RerunScene, status: str) -> None:
    document = scene.state.document
    values = rr.AnyValues(
        status=status,
        version=document.versions["multilica"],
        input_source=document.input.source,
        input_sha256=document.input.sha256,
        config=config_toml(document.config),
    )
    scene.stream.send_property(_NAME, values)


_HANDLERS: Mapping[type[events.Event], tuple[Callable[[RerunScene, Any], None], ...]] = {
    events.CalibrationStarted: (_start,),
    events.CloudPreprocessed: (log_preprocessed,),
    events.FeaturesComputed: (log_features,),
    events.CorrespondencesMatched: (pairs.log_matches, tables.log_matched),
    events.HypothesesFound: (pairs.log_hypotheses, tables.log_hypotheses),
    events.HypothesesVerified: (pairs.log_verified, tables.log_verified),
    # All pairs are searched within one stage: each is written to disk.
    events.PairRegistered: (pairs.log_registration, _flush, tables.log_registration),
    events.VerdictChanged: (pairs.log_verdict, tables.log_registration),
    events.GroupsRegistered: (pairs.log_group_registration,),
    events.LoopRegistered: (pairs.log_registration, tables.log_registration),
    events.MergeStepTaken: (log_merge_step, tables.log_candidates),
    events.MovableFound: (log_movable,),
    events.RigRefined: (tables.log_refined,),
    events.StopsLinked: (log_drive,),
    events.SurfacesMatched: (tables.log_surface_matches,),
    events.ResidualsMeasured: (log_residuals,),
    events.GroundEstimated: (log_ground,),
    events.StageFinished: (_finish_stage,),
    events.CalibrationFinished: (_finish,),
}
"""Log calls of an event: first those for people, then those for programs."""
