# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration as an MCAP file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from mcap.writer import CompressionType, Writer

from multilica import events
from multilica.errors import UnknownNameError
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult
from multilica.sinks.atomic import atomic_file
from multilica.sinks.mcap_messages import Encoding, MessageWriter
from multilica.sinks.narration import LogLine, narrate
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory
from multilica.sinks.thinning import sample_points
from multilica.sinks.toml_text import toml_text
from multilica.snapshot import Float32Array, LidarScans, Snapshot

__all__ = ["MCAP_ENCODINGS", "ResultMcap"]

MCAP_ENCODINGS = ("foxglove", "ros2")

_MAX_CLOUD_POINTS = 300_000
_LINE_SPACING_NS = 1_000_000
# Readers take a time of zero for "unset".
_STAMP_WITHOUT_CLOCK_NS = 10**9


class ResultMcap:
    """A sink that writes the calibrated clouds, transforms, log and metrics once the calibration has finished.

    It is an observer within its `with` block. Nothing is on disk before the end, so nothing is left of a run that
    was cut off.

    Args:
        path: what lies there is replaced.
        encoding: ``foxglove`` (protobuf and JSON) or ``ros2`` (CDR).

    Raises:
        UnknownNameError: no such encoding.
    """

    def __init__(self, path: Path, encoding: str = "foxglove") -> None:
        if encoding not in MCAP_ENCODINGS:
            raise UnknownNameError("MCAP encoding", encoding, MCAP_ENCODINGS)
        self.path = path
        self._encoding_name = encoding
        self._story = RunStory()
        self._lines: list[LogLine] = []

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Remember an event; write at the last one."""
        self._story(event)
        self._lines += narrate(event)
        if isinstance(event, events.CalibrationFinished):
            with atomic_file(self.path) as file:
                _write(file, self._story, self._lines, _encoding(self._encoding_name))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is open."""


def _encoding(name: str) -> Encoding:
    if name == "ros2":
        from multilica.sinks.ros2_messages import Ros2Encoding

        return Ros2Encoding()
    from multilica.sinks.foxglove_messages import FoxgloveEncoding

    return FoxgloveEncoding()


def _write(file: BinaryIO, story: RunStory, lines: list[LogLine], encoding: Encoding) -> None:
    """Transforms first, so that a reader in time order can place every cloud."""
    snapshot, result, document = story.snapshot, story.result, run_document(story)
    if snapshot is None or result is None or document is None:
        return
    start_ns = _first_stamp_ns(snapshot)
    writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile=encoding.profile, library=f"multilica {document['versions']['multilica']}")
    writer.add_metadata("multilica", _metadata(document))
    messages = MessageWriter(writer)
    messages.write(encoding.transforms(_static_poses(result), start_ns), start_ns)
    for lidar in snapshot.lidars:
        messages.write(encoding.cloud(lidar.name, _cloud(story, lidar), start_ns), start_ns)
    for index, line in enumerate(lines):
        stamp_ns = start_ns + index * _LINE_SPACING_NS
        messages.write(encoding.log(line, stamp_ns), stamp_ns)
    messages.write(encoding.metrics(_metrics(document)), start_ns + len(lines) * _LINE_SPACING_NS)
    _attach(writer, "config.toml", "application/toml", toml_text(document["config"]), start_ns)
    _attach(writer, "result.json", "application/json", json.dumps(document, indent=2, allow_nan=False), start_ns)
    writer.finish()  # type: ignore[no-untyped-call]


def _attach(writer: Writer, name: str, media_type: str, text: str, stamp_ns: int) -> None:
    writer.add_attachment(stamp_ns, stamp_ns, name, media_type, text.encode("utf-8"))


def _first_stamp_ns(snapshot: Snapshot) -> int:
    stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans if scan.stamp_ns > 0]
    return min(stamps_ns, default=_STAMP_WITHOUT_CLOCK_NS)


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
    keys = ("placed", "xyz_m", "rpy_deg", "fitness", "rmse_m")
    lidars = {name: {key: entry[key] for key in keys} for name, entry in document["lidars"].items()}
    return {
        "status": document["status"],
        "target": document["target"],
        "placed": sum(entry["placed"] for entry in lidars.values()),
        "lidars": lidars,
        "timing_s": document["timing_s"],
    }
