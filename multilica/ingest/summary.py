# SPDX-License-Identifier: Apache-2.0
"""What a source holds, without calibrating it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from multilica.config import IngestConfig
from multilica.errors import InputError, UnfitSnapshotError
from multilica.geometry import RigidTransform
from multilica.ingest.choice import choose_topics, unread_notes
from multilica.ingest.cloud import Cloud, is_cloud
from multilica.ingest.opening import open_source
from multilica.ingest.packets import OUSTER_TURN
from multilica.ingest.reading import assemble_snapshot, with_recorded_notes
from multilica.ingest.recorded import config_for
from multilica.ingest.recording import Recording, Topic
from multilica.ingest.requirement import require_calibratable
from multilica.ingest.source import PathLike, find_source
from multilica.ingest.static_transforms import read_static_transforms
from multilica.ingest.window import Window, collect_frames, require_frames
from multilica.snapshot import Snapshot

__all__ = ["CloudTopicSummary", "OtherTopicSummary", "SourceSummary", "inspect_source"]

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class CloudTopicSummary:
    """A topic with point clouds.

    Args:
        topic: topic, file or folder.
        lidar: what calibrate would call it; empty if it would not take it.
        frames: scans in the recording.
        frames_taken: scans that calibrate would take; 0 if it would not take the topic.
        rate_hz: mean over the recording; None below two scans, or without time.
        points_min, points_median, points_max: finite points per scan, over the scans of the window.
        range_median_m, range_max_m: distance of finite points from the sensor; None without any.
        first_ns, last_ns: log times of the first and the last scan; None without time.
    """

    topic: str
    message_type: str
    frame_id: str
    lidar: str
    frames: int
    frames_taken: int
    rate_hz: float | None
    points_min: int
    points_median: int
    points_max: int
    range_median_m: float | None
    range_max_m: float | None
    first_ns: int | None
    last_ns: int | None


@dataclass(frozen=True, slots=True)
class OtherTopicSummary:
    """A topic with anything else."""

    topic: str
    message_type: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class SourceSummary:
    """What `inspect` shows.

    Args:
        objection: why calibrate would not take it; empty if it would.
    """

    source: str
    format: str
    clouds: tuple[CloudTopicSummary, ...]
    others: tuple[OtherTopicSummary, ...]
    static_transforms: tuple[RigidTransform, ...]
    notes: tuple[str, ...]
    objection: str

    @property
    def duration_s(self) -> float | None:
        """From the first scan to the last; None without time."""
        times = [time for cloud in self.clouds for time in (cloud.first_ns, cloud.last_ns) if time is not None]
        return (max(times) - min(times)) / _NS_PER_S if times else None


def inspect_source(source: PathLike | Sequence[PathLike], *, config: IngestConfig | None = None) -> SourceSummary:
    """Look at a source with the eyes of `read_snapshot`; what that would refuse becomes the objection.

    Only the frames that calibrate would take are unpacked, so that a long log costs no more than a short one.

    Raises:
        SourceNotFoundError: nothing at that path.
        UnreadableSourceError: empty, or not what its name says.
        UnknownNameError: no point cloud topic of that name.
    """
    found = find_source(source)
    config = config or config_for(found.files)
    with closing(open_source(found)) as recording:
        static = read_static_transforms(recording)
        given, window, objection = _look(recording, config, found.label)
        snapshot = assemble_snapshot(found.label, given, window, static, notes=unread_notes(recording))
        snapshot = with_recorded_notes(snapshot, recording, found.files)
        return SourceSummary(
            source=found.label,
            format=recording.format,
            clouds=tuple(
                _cloud_summary(recording, topic, window, snapshot) for topic in recording.topics if is_cloud(topic)
            ),
            others=tuple(_other_summary(topic) for topic in recording.topics if not is_cloud(topic)),
            static_transforms=static[0],
            notes=snapshot.notes,
            objection=objection or _objection(snapshot),
        )


def _look(recording: Recording, config: IngestConfig, label: str) -> tuple[Mapping[str, str], Window, str]:
    """The topics that calibrate would take, frames of all point cloud topics, and what stands against it."""
    given: Mapping[str, str] = {}
    window = Window({}, {}, ())
    try:
        given = choose_topics(recording, config.topics, label, config.only)
        topics = {topic.name for topic in recording.topics if is_cloud(topic)}
        window = collect_frames(recording, topics, config, label)
        require_frames(window, given.keys(), config, label)
    except InputError as error:
        return given, window, str(error)
    return given, window, ""


def _objection(snapshot: Snapshot) -> str:
    try:
        require_calibratable(snapshot)
    except UnfitSnapshotError as error:
        return str(error)
    return ""


def _cloud_summary(recording: Recording, topic: Topic, window: Window, snapshot: Snapshot) -> CloudTopicSummary:
    frames = window.clouds.get(topic.name, ())
    lidar = next((lidar.name for lidar in snapshot.lidars if lidar.topic == topic.name), "")
    counts = [len(frame.scan.points_m) for frame in frames] or [0]
    median_m, max_m = _ranges_m(frames)
    first_ns, last_ns = recording.span_ns([topic.name]) or (None, None)
    return CloudTopicSummary(
        topic=topic.name,
        message_type=topic.message_type,
        frame_id=frames[0].frame_id if frames else "",
        lidar=lidar,
        frames=topic.count,
        frames_taken=len(frames) if lidar else 0,
        rate_hz=_rate_hz(topic, first_ns, last_ns),
        points_min=min(counts),
        points_median=int(np.median(counts)),
        points_max=max(counts),
        range_median_m=median_m,
        range_max_m=max_m,
        first_ns=first_ns,
        last_ns=last_ns,
    )


def _ranges_m(frames: Sequence[Cloud]) -> tuple[float | None, float | None]:
    ranges_m = [np.linalg.norm(frame.scan.points_m.astype(np.float64), axis=1) for frame in frames]
    joined_m = np.concatenate(ranges_m) if ranges_m else np.empty(0)
    return (float(np.median(joined_m)), float(joined_m.max())) if joined_m.size else (None, None)


def _rate_hz(topic: Topic, first_ns: int | None, last_ns: int | None) -> float | None:
    if topic.count < 2 or first_ns is None or last_ns is None or last_ns <= first_ns:
        return None
    # Between the first and the last packet lie all turns; between the first and the last scan, one less.
    periods = topic.count if topic.encoding == OUSTER_TURN else topic.count - 1
    return periods * _NS_PER_S / (last_ns - first_ns)


def _other_summary(topic: Topic) -> OtherTopicSummary:
    return OtherTopicSummary(topic.name, topic.message_type, topic.count)
