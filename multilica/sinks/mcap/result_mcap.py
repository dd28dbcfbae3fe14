# SPDX-License-Identifier: Apache-2.0
"""Sink that writes an MCAP file."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.writer import CompressionType, Writer

from multilica import events
from multilica.errors import UnknownNameError
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.slots import raw_points
from multilica.sinks.drawing.thinning import sample_points
from multilica.sinks.files.atomic import atomic_file, partial_path
from multilica.sinks.files.run_document import result_so_far, run_document
from multilica.sinks.files.toml_text import toml_text
from multilica.sinks.mcap.foxglove_layout import foxglove_layout
from multilica.sinks.mcap.messages import Encoding, McapMessage, MessageWriter
from multilica.sinks.mcap.result_drawings import result_drawings
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine, log_end, log_lines
from multilica.snapshot import Float32Array, LidarScans, Snapshot

__all__ = ["MCAP_ENCODINGS", "ResultMcap"]

MCAP_ENCODINGS = ("foxglove", "ros2")

_MAX_CLOUD_POINTS = 300_000
_LINE_SPACING_NS = 1_000_000
_MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".html": "text/html"}
# Readers treat zero as unset; ROS times end in 2038.
_STAMP_WITHOUT_CLOCK_NS = 10**9
_FAR_FUTURE_NS = 2**31 * 10**9 - 3600 * 10**9
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
    the last stage: a complete, indexed file, not compressed.

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
        if encoding not in MCAP_ENCODINGS:
            raise UnknownNameError("MCAP encoding", encoding, MCAP_ENCODINGS)
        self.path = path
        self._encoding = _encoding(encoding)
        self._attached = tuple(attached)
        self._state = state if state is not None else RunState()
        self._lines: list[LogLine] = []
        self._messages = _Messages()
        self._finished = False

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Update the state; write the partial file when a stage ends."""
        self._state(event)
        self._messages.forget(event)
        self._lines += log_lines(event)
        self._finished |= isinstance(event, events.CalibrationFinished)
        if isinstance(event, events.StageFinished):
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
        with atomic_file(path) as file:
            writer = Writer(file, compression=compression, enable_data_crcs=True)
            _write(writer, self._state, self._lines, self._encoding, self._messages, self._attached)


def _encoding(name: str) -> Encoding:
    if name == "ros2":
        from multilica.sinks.mcap.ros2_messages import Ros2Encoding

        return Ros2Encoding()
    from multilica.sinks.mcap.foxglove_messages import FoxgloveEncoding

    return FoxgloveEncoding()


@dataclass(slots=True, eq=False)
class _Messages:
    """Cache of large messages between writes: clouds per LiDAR, a drawing per topic."""

    clouds: dict[str, McapMessage] = field(default_factory=dict)
    drawings: list[McapMessage] = field(default_factory=list)

    def forget(self, event: events.Event) -> None:
        """Drop the messages that the event changes."""
        if isinstance(event, events.CloudPreprocessed):
            self.clouds.pop(event.cloud.lidar, None)
        if isinstance(event, _CHANGES_DRAWINGS):
            self.drawings.clear()

    def make(self, state: RunState, result: CalibrationResult, encoding: Encoding, stamp_ns: int) -> None:
        """Encode the missing messages."""
        for lidar in state.snapshot.lidars if state.snapshot is not None else ():
            if lidar.name not in self.clouds:
                self.clouds[lidar.name] = encoding.cloud(lidar.name, _cloud(state, lidar), stamp_ns)
        if not self.drawings:
            drawn = result_drawings(state, result).items()
            self.drawings += [encoding.drawings(topic, drawings, stamp_ns) for topic, drawings in drawn]


def _write(
    writer: Writer,
    state: RunState,
    lines: list[LogLine],
    encoding: Encoding,
    large: _Messages,
    attached: Sequence[Path],
) -> None:
    """Write transforms first, so that a reader in time order can place every cloud."""
    snapshot, document = state.snapshot, run_document(state)
    if snapshot is None or document is None:
        return
    result = result_so_far(state)
    result = replace(result, target=result.target or snapshot.names[0])
    start_ns = _first_stamp_ns(snapshot)
    writer.start(profile=encoding.profile, library=f"multilica {document.versions['multilica']}")
    writer.add_metadata("multilica", _metadata(document))
    messages = MessageWriter(writer)
    messages.write(encoding.transforms(_static_poses(result), start_ns), start_ns)
    large.make(state, result, encoding, start_ns)
    clouds = {name: large.clouds[name] for name in snapshot.names}
    for message in (*clouds.values(), *large.drawings):
        messages.write(message, start_ns)
    for index, line in enumerate(lines):
        stamp_ns = start_ns + index * _LINE_SPACING_NS
        messages.write(encoding.log(line, stamp_ns), stamp_ns)
    messages.write(encoding.metrics(_metrics(document)), start_ns + len(lines) * _LINE_SPACING_NS)
    texts = {
        "config.toml": toml_text(document.config.model_dump(mode="json")),
        "result.json": document.model_dump_json(),
        "foxglove-layout.json": foxglove_layout(result.target, {name: cloud.topic for name, cloud in clouds.items()}),
    }
    found = {path.name: path.read_bytes() for path in attached if path.is_file()}
    for name, data in ({name: text.encode("utf-8") for name, text in texts.items()} | found).items():
        writer.add_attachment(start_ns, start_ns, name, _MEDIA_TYPES[Path(name).suffix], data)
    writer.finish()  # type: ignore[no-untyped-call]


def _first_stamp_ns(snapshot: Snapshot) -> int:
    stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans]
    return min((stamp_ns for stamp_ns in stamps_ns if 0 < stamp_ns < _FAR_FUTURE_NS), default=_STAMP_WITHOUT_CLOCK_NS)


def _static_poses(result: CalibrationResult) -> list[RigidTransform]:
    """Return the base frame above the target, if there is one, then every placed LiDAR."""
    base = [result.ground.T_base_target] if result.ground is not None else []
    placed = [place.T_target_source for place in result.placements if place.placed and place.lidar != result.target]
    return [*base, *(pose for pose in placed if pose is not None)]


def _cloud(state: RunState, lidar: LidarScans) -> Float32Array:
    """Return the thinned preprocessed cloud, else the raw one."""
    cloud = state.clouds.get(lidar.name)
    return sample_points(raw_points(lidar) if cloud is None else cloud.points_m, _MAX_CLOUD_POINTS)


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
    figures = {"placed", "xyz_m", "rpy_deg", "fitness", "rmse_m"}
    return {
        "status": document.status,
        "target": document.target,
        "placed": len(document.placed),
        "lidars": [
            {"name": name, **entry.model_dump(mode="json", include=figures, exclude_none=True)}
            for name, entry in document.lidars.items()
        ],
        "stages": [{"name": name, "duration_s": duration_s} for name, duration_s in document.timing_s.items()],
    }
