# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration as an MCAP file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from mcap.writer import CompressionType, Writer

from multilica import events
from multilica.errors import UnknownNameError
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult
from multilica.sinks.atomic import atomic_file, partial_path
from multilica.sinks.foxglove_layout import foxglove_layout
from multilica.sinks.mcap_messages import Encoding, Message, MessageWriter
from multilica.sinks.narration import LogLine, narrate, narrate_end
from multilica.sinks.result_drawings import result_drawings
from multilica.sinks.run_document import result_so_far, run_document
from multilica.sinks.run_story import RunStory
from multilica.sinks.thinning import sample_points
from multilica.sinks.toml_text import toml_text
from multilica.snapshot import Float32Array, LidarScans, Snapshot

__all__ = ["MCAP_ENCODINGS", "ResultMcap"]

MCAP_ENCODINGS = ("foxglove", "ros2")

_MAX_CLOUD_POINTS = 300_000
_LINE_SPACING_NS = 1_000_000
_MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".html": "text/html"}
# Readers take a time of zero for "unset"; ROS has no times from 2038 on.
_STAMP_WITHOUT_CLOCK_NS = 10**9
_FAR_FUTURE_NS = 2**31 * 10**9 - 3600 * 10**9
_CHANGES_DRAWINGS = (
    events.CloudPreprocessed,
    events.CorrespondencesMatched,
    events.HypothesesFound,
    events.PairRegistered,
    events.TargetChosen,
    events.CalibrationFinished,
)


class ResultMcap:
    """A sink that writes the calibrated clouds, transforms, drawings, log and metrics of a calibration.

    It is an observer within its `with` block. The file is written when the block ends, so that it can hold what other
    sinks wrote. Until then `<stem>.partial.mcap` holds what is known, written anew at the end of each stage: a whole,
    indexed file at any time, not compressed. It stays when the run is interrupted or killed.

    Args:
        path: the final name; what lies there is replaced.
        encoding: ``foxglove`` (protobuf and JSON) or ``ros2`` (CDR).
        attached: files that are attached if they are there, beside the configuration and the result; the result as it
            lies there, if it is among them.
        story: shared with other sinks of the run; its own if there are none.

    Raises:
        UnknownNameError: no such encoding.
    """

    def __init__(
        self,
        path: Path,
        encoding: str = "foxglove",
        attached: Sequence[Path] = (),
        story: RunStory | None = None,
    ) -> None:
        if encoding not in MCAP_ENCODINGS:
            raise UnknownNameError("MCAP encoding", encoding, MCAP_ENCODINGS)
        self.path = path
        self._encoding = _encoding(encoding)
        self._attached = tuple(attached)
        self._story = story if story is not None else RunStory()
        self._lines: list[LogLine] = []
        self._messages = _Messages()
        self._finished = False

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Remember an event; what is known is written when a stage ends."""
        self._story(event)
        self._messages.forget(event)
        self._lines += narrate(event)
        self._finished |= isinstance(event, events.CalibrationFinished)
        if isinstance(event, events.StageFinished):
            self._write(partial_path(self.path))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the end of a calibration that has started."""
        partial = partial_path(self.path)
        if self._finished:
            self._write(self.path, CompressionType.ZSTD)
            partial.unlink(missing_ok=True)
        elif self._story.snapshot is not None:
            self._lines.append(narrate_end(error))
            self._write(partial)

    def _write(self, path: Path, compression: CompressionType = CompressionType.NONE) -> None:
        with atomic_file(path) as file:
            writer = Writer(file, compression=compression, enable_data_crcs=True)
            _write(writer, self._story, self._lines, self._encoding, self._messages, self._attached)


def _encoding(name: str) -> Encoding:
    if name == "ros2":
        from multilica.sinks.ros2_messages import Ros2Encoding

        return Ros2Encoding()
    from multilica.sinks.foxglove_messages import FoxgloveEncoding

    return FoxgloveEncoding()


@dataclass(slots=True, eq=False)
class _Messages:
    """Large messages that stay as they are from one writing to the next.

    Args:
        clouds: per LiDAR, as it was last written.
        drawings: one per topic; none before they are asked for.
    """

    clouds: dict[str, Message] = field(default_factory=dict)
    drawings: list[Message] = field(default_factory=list)

    def forget(self, event: events.Event) -> None:
        """Drop what the event changes."""
        if isinstance(event, events.CloudPreprocessed):
            self.clouds.pop(event.cloud.lidar, None)
        if isinstance(event, _CHANGES_DRAWINGS):
            self.drawings.clear()

    def make(self, story: RunStory, result: CalibrationResult, encoding: Encoding, stamp_ns: int) -> None:
        """Encode what is not there."""
        for lidar in story.snapshot.lidars if story.snapshot is not None else ():
            if lidar.name not in self.clouds:
                self.clouds[lidar.name] = encoding.cloud(lidar.name, _cloud(story, lidar), stamp_ns)
        if not self.drawings:
            drawn = result_drawings(story, result).items()
            self.drawings += [encoding.drawings(topic, drawings, stamp_ns) for topic, drawings in drawn]


def _write(
    writer: Writer,
    story: RunStory,
    lines: list[LogLine],
    encoding: Encoding,
    large: _Messages,
    attached: Sequence[Path],
) -> None:
    """Transforms first, so that a reader in time order can place every cloud."""
    snapshot, document = story.snapshot, run_document(story)
    if snapshot is None or document is None:
        return
    result = result_so_far(story)
    result = replace(result, target=result.target or snapshot.names[0])
    start_ns = _first_stamp_ns(snapshot)
    writer.start(profile=encoding.profile, library=f"multilica {document['versions']['multilica']}")
    writer.add_metadata("multilica", _metadata(document))
    messages = MessageWriter(writer)
    messages.write(encoding.transforms(_static_poses(result), start_ns), start_ns)
    large.make(story, result, encoding, start_ns)
    clouds = {name: large.clouds[name] for name in snapshot.names}
    for message in (*clouds.values(), *large.drawings):
        messages.write(message, start_ns)
    for index, line in enumerate(lines):
        stamp_ns = start_ns + index * _LINE_SPACING_NS
        messages.write(encoding.log(line, stamp_ns), stamp_ns)
    messages.write(encoding.metrics(_metrics(document)), start_ns + len(lines) * _LINE_SPACING_NS)
    texts = {
        "config.toml": toml_text(document["config"]),
        "result.json": json.dumps(document, allow_nan=False),
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
    """The base frame above the target where there is one, then every placed LiDAR below it."""
    base = [result.ground.T_base_target] if result.ground is not None else []
    placed = [place.T_target_source for place in result.placements if place.placed and place.lidar != result.target]
    return [*base, *(pose for pose in placed if pose is not None)]


def _cloud(story: RunStory, lidar: LidarScans) -> Float32Array:
    """The preprocessed cloud, else the raw one, thinned."""
    cloud = story.clouds.get(lidar.name)
    if cloud is not None:
        return sample_points(cloud.points_m, _MAX_CLOUD_POINTS)
    raw = [scan.points_m for scan in lidar.scans]
    return sample_points(np.concatenate(raw) if raw else np.empty((0, 3)), _MAX_CLOUD_POINTS)


def _metadata(document: Mapping[str, Any]) -> dict[str, str]:
    return {
        "version": document["versions"]["multilica"],
        "status": document["status"],
        "target": document["target"],
        "input_source": document["input"]["source"],
        "input_sha256": document["input"]["sha256"],
    }


def _metrics(document: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of each LiDAR that has them, without those that it lacks."""
    keys = ("placed", "xyz_m", "rpy_deg", "fitness", "rmse_m")
    lidars = [
        {"name": name, **{key: entry[key] for key in keys if entry[key] is not None}}
        for name, entry in document["lidars"].items()
    ]
    return {
        "status": document["status"],
        "target": document["target"],
        "placed": sum(entry["placed"] for entry in lidars),
        "lidars": lidars,
        "stages": [{"name": name, "duration_s": duration_s} for name, duration_s in document["timing_s"].items()],
    }
