# SPDX-License-Identifier: Apache-2.0
"""Sink that writes an MCAP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from mcap.writer import CompressionType

from multilica import events
from multilica.errors import UnknownNameError
from multilica.geometry import Float32Array, RigidTransform
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.shapes import sample_points
from multilica.sinks.files.atomic import atomic_file, partial_path
from multilica.sinks.files.result_files import config_toml
from multilica.sinks.mcap.messages import McapMessage, MessageWriter, mcap_messages
from multilica.sinks.mcap.result_drawings import cloud_frames, foxglove_layout, result_drawings
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine, log_end, log_lines
from multilica.snapshot import LidarScans, Snapshot

if TYPE_CHECKING:
    from multilica.sinks.mcap.foxglove_messages import FoxgloveEncoding
    from multilica.sinks.mcap.ros2_messages import Ros2Encoding

_MAX_CLOUD_POINTS = 300_000
_LINE_SPACING_NS = 1_000_000
_MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".html": "text/html"}
# Readers treat zero as unset; ROS times end in 2038.
_STAMP_WITHOUT_CLOCK_NS = 10**9
_FAR_FUTURE_NS = 2**31 * 10**9 - 3600 * 10**9
# They take milliseconds, and the whole file follows.
_LAST_STAGES = ("merge", "refine", "ground")
_CHANGES_DRAWINGS = (
    events.CloudPreprocessed,
    events.CorrespondencesMatched,
    events.HypothesesFound,
    events.PairRegistered,
    events.VerdictChanged,
    events.LoopRegistered,
    events.TargetChosen,
    events.CalibrationFinished,
)


class ResultMcap:
    """A sink that writes the calibrated clouds, transforms, drawings, log and metrics of a calibration.

    Use it as an observer within its `with` block. The file is written at the end of the block and can attach files of
    other sinks. Until then, and after an interrupted or killed run, `<stem>.partial.mcap` has the state at the end of
    the last long stage: a complete, indexed file, not compressed.

    Args:
        path: final name; an existing file is replaced.
        encoding: ``foxglove`` (protobuf and JSON) or ``ros2`` (CDR).
        attached: files to attach if they exist, beside the configuration and the result.
        state: shared with other sinks of the run.

    Raises:
        UnknownNameError: no such encoding.
    """

    def __init__(
        self,
        path: Path,
        encoding: str = "foxglove",
        attached: Sequence[Path] = (),
        state: RunState | None = None,
    ) -> None:
        self.path = path
        self._encoding = _encoding(encoding)
        self._attached = tuple(attached)
        self._state = state if state is not None else RunState()
        self._lines: list[LogLine] = []
        self._cloud_topics: dict[str, str] = {}
        self._drawings: list[McapMessage] = []
        self._finished = False

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Update the state; write the partial file when a stage ends, or the last one of stages that ran together."""
        self._state(event)
        if isinstance(event, _CHANGES_DRAWINGS):
            self._drawings.clear()
        self._lines += log_lines(event)
        self._finished |= isinstance(event, events.CalibrationFinished)
        ended = isinstance(event, events.StageFinished) and event.stage == self._state.stage
        if ended and self._state.stage not in _LAST_STAGES:
            self._write(partial_path(self.path))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the file of a calibration that has started."""
        partial = partial_path(self.path)
        if self._finished:
            self._write(self.path, CompressionType.ZSTD)
            partial.unlink(missing_ok=True)
        elif self._state.snapshot is not None:
            self._lines.append(log_end(error))
            self._write(partial)

    def _write(self, path: Path, compression: CompressionType = CompressionType.NONE) -> None:
        snapshot, document = self._state.snapshot, self._state.document
        if snapshot is None:
            return
        target = document.target or snapshot.names[0]
        start_ns = _first_stamp_ns(snapshot)
        end_ns = start_ns + len(self._lines) * _LINE_SPACING_NS
        profile = self._encoding.profile
        with atomic_file(path) as file, mcap_messages(file, profile, compression=compression) as messages:
            messages.writer.add_metadata("multilica", _metadata(document))
            self._write_scene(messages, snapshot, document.model_copy(update={"target": target}), start_ns)
            for index, line in enumerate(self._lines):
                stamp_ns = start_ns + index * _LINE_SPACING_NS
                messages.write(self._encoding.log(line, stamp_ns), stamp_ns)
            messages.write(self._encoding.metrics(_metrics(document)), end_ns)
            for name, data in self._attachments(document, target).items():
                messages.writer.add_attachment(start_ns, start_ns, name, _MEDIA_TYPES[Path(name).suffix], data)

    def _write_scene(
        self, messages: MessageWriter, snapshot: Snapshot, document: ResultDocument, stamp_ns: int
    ) -> None:
        """Write transforms first, so that a reader in time order can place every cloud."""
        frames = cloud_frames(document)
        messages.write(self._encoding.transforms(_static_poses(document, frames), stamp_ns), stamp_ns)
        for lidar in snapshot.lidars:
            points_m = _shown_points(self._state, lidar)
            cloud = self._encoding.cloud(lidar.name, frames[lidar.name], points_m, stamp_ns)
            self._cloud_topics[lidar.name] = cloud.topic
            messages.write(cloud, stamp_ns)
        if not self._drawings:
            drawn = result_drawings(self._state, document).items()
            self._drawings = [self._encoding.drawings(topic, drawings, stamp_ns) for topic, drawings in drawn]
        for drawing in self._drawings:
            messages.write(drawing, stamp_ns)

    def _attachments(self, document: ResultDocument, target: str) -> dict[str, bytes]:
        return {
            "config.toml": config_toml(document.config).encode(),
            "result.json": document.model_dump_json().encode(),
            "foxglove-layout.json": foxglove_layout(target, self._cloud_topics).encode(),
            **{path.name: path.read_bytes() for path in self._attached if path.is_file()},
        }


def _encoding(name: str) -> FoxgloveEncoding | Ros2Encoding:
    if name == "ros2":
        from multilica.sinks.mcap.ros2_messages import Ros2Encoding

        return Ros2Encoding()
    if name == "foxglove":
        from multilica.sinks.mcap.foxglove_messages import FoxgloveEncoding

        return FoxgloveEncoding()
    raise UnknownNameError("MCAP encoding", name, ("foxglove", "ros2"))


def _first_stamp_ns(snapshot: Snapshot) -> int:
    stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans]
    return min((stamp_ns for stamp_ns in stamps_ns if 0 < stamp_ns < _FAR_FUTURE_NS), default=_STAMP_WITHOUT_CLOCK_NS)


def _static_poses(document: ResultDocument, frames: Mapping[str, str]) -> list[RigidTransform]:
    """Return the base frame above the target, if there is one, then the frame of every LiDAR with a pose."""
    target, ground = document.target, document.ground
    base = [] if ground is None else [RigidTransform(ground.frame, target, np.asarray(ground.T_base_target))]
    poses = (pose for name, pose in document.poses.items() if name != target)
    return [*base, *(RigidTransform(target, frames[pose.source], pose.matrix) for pose in poses)]


def _shown_points(state: RunState, lidar: LidarScans) -> Float32Array:
    """Return the thinned preprocessed cloud, else the raw one."""
    cloud = state.clouds.get(lidar.name)
    return sample_points(lidar.points_m if cloud is None else cloud.points_m, _MAX_CLOUD_POINTS)


def _metadata(document: ResultDocument) -> dict[str, str]:
    return {
        "version": document.versions["multilica"],
        "status": document.status,
        "target": document.target,
        "input_source": document.input.source,
        "input_sha256": document.input.sha256,
    }


def _metrics(document: ResultDocument) -> dict[str, Any]:
    """Return status, figures per LiDAR without those that it lacks, and wall times."""
    figures = {"placed", "status", "xyz_m", "rpy_deg", "fitness", "rmse_m"}
    return {
        "status": document.status,
        "target": document.target,
        "placed": len(document.placed),
        "uncertain": sum(entry.status == "uncertain" for entry in document.lidars.values()),
        "lidars": [
            {"name": name, **entry.model_dump(mode="json", include=figures, exclude_none=True)}
            for name, entry in document.lidars.items()
        ],
        "stages": [{"name": name, "duration_s": duration_s} for name, duration_s in document.timing_s.items()],
    }
