# SPDX-License-Identifier: Apache-2.0
"""Sink that writes an MCAP file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import CompressionType

from multilica import events
from multilica.errors import UnknownNameError
from multilica.geometry import FloatArray, RigidTransform
from multilica.results.document import ResultDocument
from multilica.sinks import drawing
from multilica.sinks.files.atomic import atomic_file, partial_path
from multilica.sinks.files.result_files import config_toml
from multilica.sinks.mcap.messages import MessageWriter, mcap_messages
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine, log_end, log_lines, pair_label
from multilica.snapshot import Snapshot

if TYPE_CHECKING:
    from multilica.sinks.mcap.foxglove_messages import FoxgloveEncoding
    from multilica.sinks.mcap.ros2_messages import Ros2Encoding

DRAWING_TOPICS = ("/matches", "/merge_graph", "/fields_of_view", "/uncertainty")

_MAX_MATCHES = 500
_WAITING_HEIGHT_M = 1.5
_NODE_RADIUS_M = 0.06
_SCENE, _LOG, _METRICS = "3D!multilica", "RosOut!multilica", "RawMessages!multilica"
_GRID = "#ffffff20"
_STOP_AXES_M = 2.0
_MAX_CLOUD_POINTS = 300_000
_LINE_SPACING_NS = 1_000_000
_MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".html": "text/html"}
# Readers treat zero as unset; ROS times end in 2038.
_STAMP_WITHOUT_CLOCK_NS = 10**9
_FAR_FUTURE_NS = 2**31 * 10**9 - 3600 * 10**9
# They take milliseconds, and the whole file follows.
_LAST_STAGES = ("merge", "refine", "ground")


def _cloud_frames(document: ResultDocument) -> dict[str, str]:
    """Return the frame of each LiDAR's cloud: its name, which no transform has for an uncertain LiDAR."""
    return {
        name: f"uncertain/{name}" if entry.status == "uncertain" else name for name, entry in document.lidars.items()
    }


def _matches(state: RunState, frames: Mapping[str, str]) -> Iterator[drawing.Drawing]:
    """Draw a sample of each pair's matches at its best pose: kept ones are short, rejected ones long."""
    for pair, matches in sorted(state.matches.items()):
        coarse, found = state.coarse.get(pair), state.registrations.get(pair)
        if coarse is None or not coarse.hypotheses:
            continue
        index = max(found.hypothesis, 0) if found is not None else 0
        hypothesis = coarse.hypotheses[index]
        pose = found.T_target_source.with_target(pair[0]) if found is not None else hypothesis.T_target_source
        kept = drawing.kept_matches(state, matches, hypothesis)
        lines = (
            drawing.Lines(drawing.match_lines(matches, kept, pose, _MAX_MATCHES), drawing.KEPT),
            drawing.Lines(drawing.match_lines(matches, ~kept, pose, _MAX_MATCHES), drawing.REJECTED),
        )
        yield drawing.Drawing(pair_label(*pair), frames[matches.target], lines)


def _merge_graph(state: RunState, document: ResultDocument) -> Iterator[drawing.Drawing]:
    """Draw a node per LiDAR, unplaced ones above the target, and an edge per registered pair with its verdict."""
    colours, poses = drawing.distinct_colours(state.lidars), document.poses
    waiting = [name for name in document.lidars if name not in poses]
    places_m = {name: pose.xyz_m for name, pose in poses.items()}
    places_m |= {name: np.array([0.0, 0.0, _WAITING_HEIGHT_M * (1 + row)]) for row, name in enumerate(waiting)}
    for name, entry in document.lidars.items():
        text = name if entry.placed else f"{name}: {entry.status.replace('_', ' ')}"
        colour = colours[name] if name in poses else drawing.VIOLATE
        label = drawing.Label(places_m[name] + np.array([0.0, 0.0, 2.0 * _NODE_RADIUS_M]), text, colour)
        yield drawing.Drawing(name, document.target, labels=(label,), lines=(_cross(places_m[name], colour),))
    for _, found in sorted(state.registrations.items()):
        start_m, end_m = places_m[found.target], places_m[found.source]
        colour = drawing.VERDICT_COLOURS[found.verdict.outcome]
        text = f"{found.fitness:.2f} {found.verdict.outcome}"
        label = drawing.Label(start_m + drawing.EDGE_LABEL_SHARE * (end_m - start_m), text, colour)
        edge = drawing.Lines(np.stack([start_m, end_m])[None], colour)
        name = pair_label(found.target, found.source)
        yield drawing.Drawing(name, document.target, (edge,), labels=(label,))


def _cross(centre_m: FloatArray, colour: tuple[int, int, int]) -> drawing.Lines:
    arms_m = _NODE_RADIUS_M * np.eye(3)
    return drawing.Lines(np.stack([centre_m - arms_m, centre_m + arms_m], axis=1), colour)


def _fields_of_view(state: RunState, frames: Mapping[str, str]) -> Iterator[drawing.Drawing]:
    colours = drawing.distinct_colours(state.lidars)
    for lidar in sorted(state.clouds):
        strips = drawing.shown_field_of_view(state, lidar)
        if strips:
            segments_m = np.concatenate([np.stack([strip[:-1], strip[1:]], axis=1) for strip in strips])
            yield drawing.Drawing(lidar, frames[lidar], (drawing.Lines(segments_m, colours[lidar]),))


def _uncertainty(state: RunState, document: ResultDocument) -> Iterator[drawing.Drawing]:
    colours, scale = drawing.distinct_colours(state.lidars), drawing.ellipsoid_scale(document)
    for lidar in document.lidars:
        found = drawing.uncertainty_ellipsoid(document, lidar)
        if found is not None:
            half_sizes_m, axes = found
            shown = drawing.Ellipsoid(axes, scale * half_sizes_m, colours[lidar])
            text = drawing.ellipsoid_label(document, lidar, scale)
            labels = (drawing.Label(axes.xyz_m, text, drawing.UNCERTAIN),) if text else ()
            yield drawing.Drawing(lidar, document.target, ellipsoids=(shown,), labels=labels)


def _stop_poses(document: ResultDocument) -> Iterator[tuple[str, list[RigidTransform]]]:
    """Yield the first stop of each group of linked ones with the target's poses at all of them, in its own frame."""
    for first in dict.fromkeys(stop.first for stop in document.stops):
        group = (stop for stop in document.stops if stop.first == first)
        yield (
            first,
            [RigidTransform(document.target, stop.name, np.asarray(stop.T_first_stop)) for stop in group],
        )


def foxglove_layout(target: str, cloud_topics: Mapping[str, str], pose_topics: Sequence[str] = ()) -> str:
    """Return JSON for "Import from file": clouds and drawings in a scene that follows the target, log and metrics."""
    layout = {
        "configById": {
            _SCENE: _scene(target, cloud_topics, pose_topics),
            _LOG: {"searchTerms": [], "minLogLevel": 1, "topicToRender": "/log"},
            _METRICS: {"topicPath": "/metrics", "diffEnabled": False},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _SCENE,
            "second": {"direction": "column", "first": _METRICS, "second": _LOG, "splitPercentage": 50},
            "splitPercentage": 70,
        },
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _scene(target: str, cloud_topics: Mapping[str, str], pose_topics: Sequence[str]) -> dict[str, Any]:
    colours = drawing.distinct_colours(tuple(cloud_topics))
    clouds = {
        topic: {
            "visible": True,
            "colorMode": "flat",
            # If none is named, the panel picks one and colours by it.
            "colorField": "z",
            "flatColor": drawing.hex_colour(colours[name]),
            "pointSize": 2,
        }
        for name, topic in cloud_topics.items()
    }
    # Matches are hidden at first: hundreds of lines.
    drawings = {topic: {"visible": topic != "/matches"} for topic in DRAWING_TOPICS}
    poses = {topic: {"visible": True, "type": "axis", "axisScale": _STOP_AXES_M} for topic in pose_topics}
    return {
        "followMode": "follow-pose",
        "followTf": target,
        "scene": {"transforms": {"showLabel": True, "axisScale": 0.5}},
        "cameraState": {"perspective": True, "distance": 30, "phi": 55, "thetaOffset": 45, "targetOffset": [0, 0, 0]},
        "topics": {**clouds, **drawings, **poses},
        "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "size": 40, "divisions": 40, "color": _GRID}},
    }


class ResultMcap(AbstractContextManager["ResultMcap"]):
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
        self, path: Path, encoding: str = "foxglove", attached: Sequence[Path] = (), state: RunState | None = None
    ) -> None:
        self.path = path
        self._encoding = _encoding(encoding)
        self._attached = tuple(attached)
        self._state = state or RunState()
        self._lines: list[LogLine] = []
        self._cloud_topics: dict[str, str] = {}
        self._pose_topics: list[str] = []
        self._finished = False

    def __call__(self, event: events.Event) -> None:
        """Update the state; write the partial file when a stage ends, or the last one of stages that ran together."""
        self._state(event)
        self._lines += log_lines(event)
        self._finished |= isinstance(event, events.CalibrationFinished)
        ended = isinstance(event, events.StageFinished) and event.stage == self._state.stage
        if ended and self._state.stage not in _LAST_STAGES:
            self._write(partial_path(self.path))

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
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
        stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans]
        known_ns = (stamp_ns for stamp_ns in stamps_ns if 0 < stamp_ns < _FAR_FUTURE_NS)
        start_ns = min(known_ns, default=_STAMP_WITHOUT_CLOCK_NS)
        given = document.input
        metadata = {"version": document.versions["multilica"], "status": document.status, "target": document.target}
        metadata |= {"input_source": given.source, "input_sha256": given.sha256}
        end_ns = start_ns + len(self._lines) * _LINE_SPACING_NS
        profile = self._encoding.profile
        with atomic_file(path) as file, mcap_messages(file, profile, compression=compression) as messages:
            messages.writer.add_metadata("multilica", metadata)
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
        state, frames = self._state, _cloud_frames(document)
        messages.write(self._encoding.transforms(_static_poses(document, frames), stamp_ns), stamp_ns)
        for lidar in snapshot.lidars:
            shown_m = (
                drawing.sample_points(state.clouds[lidar.name].points_m, _MAX_CLOUD_POINTS)
                if lidar.name in state.clouds
                else drawing.sample_returns(lidar, _MAX_CLOUD_POINTS)
            )
            cloud = self._encoding.cloud(lidar.name, frames[lidar.name], shown_m, stamp_ns)
            self._cloud_topics[lidar.name] = cloud.topic
            messages.write(cloud, stamp_ns)
        views, sigmas = _fields_of_view(state, frames), _uncertainty(state, document)
        drawings = (_matches(state, frames), _merge_graph(state, document), views, sigmas)
        for topic, found in zip(DRAWING_TOPICS, drawings, strict=True):
            messages.write(self._encoding.drawings(topic, tuple(found), stamp_ns), stamp_ns)
        drives = [self._encoding.stop_poses(first, poses, stamp_ns) for first, poses in _stop_poses(document)]
        self._pose_topics = [message.topic for message in drives]
        for message in drives:
            messages.write(message, stamp_ns)

    def _attachments(self, document: ResultDocument, target: str) -> dict[str, bytes]:
        return {
            "config.toml": config_toml(document.config).encode(),
            "result.json": document.model_dump_json().encode(),
            "foxglove-layout.json": foxglove_layout(target, self._cloud_topics, self._pose_topics).encode(),
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


def _static_poses(document: ResultDocument, frames: Mapping[str, str]) -> list[RigidTransform]:
    """Return the base frame above the target, if there is one without a doubt, then that of every LiDAR with a pose."""
    target, ground = document.target, document.ground
    is_sure = ground is not None and not ground.doubt
    base = [RigidTransform(ground.frame, target, np.asarray(ground.T_base_target))] if ground and is_sure else []
    poses = (pose for name, pose in document.poses.items() if name != target)
    return [*base, *(RigidTransform(target, frames[pose.source], pose.matrix) for pose in poses)]


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
