# SPDX-License-Identifier: Apache-2.0
"""The summary of a source for `inspect`."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from multilica.config import IngestConfig
from multilica.errors import InputError, UnfitSnapshotError, listed
from multilica.geometry import RigidTransform
from multilica.ingest.locate import PathLike, TakenFor, are_stops, find_source, locate, taken_for
from multilica.ingest.memory import limited_memory
from multilica.ingest.message_types import OUSTER_TURN, Cloud, is_cloud
from multilica.ingest.metadata import config_for, with_recorded_notes
from multilica.ingest.opening import open_source
from multilica.ingest.recording import Recording, Span, Topic
from multilica.ingest.remote.address import without_secrets
from multilica.ingest.remote.remote_file import SourceFile
from multilica.ingest.selection.time_range import find_time_range
from multilica.ingest.selection.topics import choose_topics, cloud_span, named_topics, unread_notes
from multilica.ingest.selection.window import Window, collect_frames, require_frames
from multilica.ingest.snapshot_reader import (
    assemble_snapshot,
    live_address,
    nothing_sent,
    open_vehicle,
    refused_as_strict,
    require_calibratable,
)
from multilica.ingest.stops import standstills_of
from multilica.ingest.transforms import read_static_transforms
from multilica.pointcloud2 import MERGED_TOPIC
from multilica.snapshot import Snapshot

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class CloudTopicSummary:
    """A topic with point clouds.

    Args:
        topic: topic, file or folder.
        lidar: the LiDAR's name in a calibration; empty if the topic would not be used.
        frames: scans in the recording.
        frames_taken: scans that a calibration would use.
        rate_hz: mean over the recording; None below two scans, or without time.
        points_min, points_median, points_max: finite points per scan of the window, without zeros of lost beams.
        range_median_m, range_max_m: distance of finite points from the sensor; None without any.
        first_ns, last_ns: log times of the first and the last scan, since the clock was set; None without time.
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
class Standstill:
    """A time in which the vehicle stands still: its beginning after the first scan, and its length."""

    start_s: float
    length_s: float


@dataclass(frozen=True, slots=True, eq=False)
class SourceSummary:
    """The contents of a source.

    Args:
        taken_for: what each of the sources that were given is taken for.
        standstills: of a log, by `standstill_evidence`; none if it is shorter than two seconds, or nothing shows any.
        objection: why it cannot be calibrated; empty if it can.
        live: True for a running vehicle, whose messages count from now on: scans as far as they were taken, others
            not at all.
    """

    source: str
    format: str
    clouds: tuple[CloudTopicSummary, ...]
    others: tuple[Topic, ...]
    static_transforms: tuple[RigidTransform, ...]
    notes: tuple[str, ...]
    objection: str
    taken_for: Mapping[str, TakenFor]
    standstills: tuple[Standstill, ...] = ()
    standstill_evidence: str = ""
    live: bool = False

    @property
    def duration_s(self) -> float | None:
        """Time from the first scan to the last; None without time."""
        times = [time for cloud in self.clouds for time in (cloud.first_ns, cloud.last_ns) if time is not None]
        return (max(times) - min(times)) / _NS_PER_S if times else None


def inspect_source(source: PathLike | Sequence[PathLike], *, config: IngestConfig | None = None) -> SourceSummary:
    """Summarise a source as `read_snapshot` reads it; an error that this would raise becomes the objection.

    Only the frames of the window and a few samples are decoded, so a long log takes no longer than a short one. If
    several folders are stops of one drive, the first one is summarised. From a running vehicle, `config.frames` frames
    of each LiDAR are taken, as by `listen`.

    Raises:
        SourceNotFoundError: nothing exists at that path.
        UnreadableSourceError: the source is empty, or not what its name says.
        UnknownNameError: there is no point cloud topic of that name.
    """
    given_sources = [source] if isinstance(source, PathLike) else source
    address = live_address(given_sources)
    if address:
        return _inspect_vehicle(address, config or IngestConfig())
    paths = [locate(each) for each in given_sources]
    further = paths[1:] if are_stops(paths) else []
    found = find_source(paths[:1] if further else paths)
    config = config or config_for(found.files)
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        static = read_static_transforms(recording)
        given, window, objection = _read(recording, config, found.label)
        if config.strict and found.faults:
            objection = objection or refused_as_strict(found)
        notes, chosen = [*found.notes, *unread_notes(recording)], named_topics(given, config)
        snapshot = assemble_snapshot(found.label, given, window, static, notes=notes, chosen=chosen)
        snapshot = with_recorded_notes(snapshot, recording, found.files)
        snapshot = replace(snapshot, notes=(*snapshot.notes, *_notes_on(further)))
        span, still = cloud_span(recording), standstills_of(recording, given)
        spans = {topic.name: recording.span_ns([topic.name]) for topic in recording.topics}
        summary = _summary(snapshot, recording, window, spans, objection, since_ns=span[0] if span else 0)
        return replace(
            summary,
            source=found.label,
            taken_for=dict(zip(map(str, paths), taken_for(paths), strict=True)),
            standstills=tuple(_standstill(each, span) for each in still.spans) if still and span else (),
            standstill_evidence=still.evidence if still else "",
        )


def _inspect_vehicle(url: str, config: IngestConfig) -> SourceSummary:
    """Summarise what a running vehicle offers and `listen` takes; a rate is that of the scans that were taken."""
    label = without_secrets(url)
    with (
        limited_memory(config.max_memory_mb, label),
        closing(open_vehicle(url, config, lambda _topic, _count: None)) as recording,
    ):
        given, window, objection = _read(recording, config, label)
        if given and not window.clouds:
            objection = nothing_sent(label, given, config)
        static = read_static_transforms(recording)
        notes = [*unread_notes(recording), *recording.notes]
        snapshot = assemble_snapshot(label, given, window, static, notes=notes, chosen=named_topics(given, config))
        taken = {topic: [frame.scan.log_time_ns for frame in frames] for topic, frames in window.clouds.items()}
        recording.topics = tuple(replace(topic, count=len(taken.get(topic.name, ()))) for topic in recording.topics)
        spans = {topic: (min(times), max(times)) for topic, times in taken.items()}
        return _summary(snapshot, recording, window, spans, objection, live=True)


def _summary(
    snapshot: Snapshot,
    recording: Recording,
    window: Window,
    spans: Mapping[str, Span | None],
    objection: str,
    *,
    since_ns: int = 0,
    live: bool = False,
) -> SourceSummary:
    """Summarise what was read; the clock was set at `since_ns`."""
    try:
        require_calibratable(replace(snapshot, notes=()))
    except UnfitSnapshotError as error:
        objection = objection or str(error)
    return SourceSummary(
        source=snapshot.source,
        format=recording.format,
        clouds=tuple(
            _cloud_summary(topic, window.clouds.get(topic.name, ()), spans.get(topic.name), snapshot, since_ns)
            for topic in recording.topics
            if is_cloud(topic)
        ),
        others=tuple(topic for topic in recording.topics if not is_cloud(topic)),
        static_transforms=snapshot.static_transforms,
        notes=snapshot.notes,
        objection=objection,
        taken_for={},
        live=live,
    )


def _standstill(standstill: Span, span: Span) -> Standstill:
    return Standstill((standstill[0] - span[0]) / _NS_PER_S, (standstill[1] - standstill[0]) / _NS_PER_S)


def _notes_on(further: Sequence[SourceFile]) -> list[str]:
    if not further:
        return []
    return [f"{listed([str(path) for path in further])} hold the same LiDARs: stops of one drive, a snapshot each."]


def _read(recording: Recording, config: IngestConfig, label: str) -> tuple[Mapping[str, str], Window, str]:
    """Return the chosen topics, the frames of all LiDARs, chosen or not, and the objection."""
    given: Mapping[str, str] = {}
    window = Window({}, {}, ())
    try:
        given = choose_topics(recording, config.topics, label, config.only)
        topics = {topic.name for topic in recording.topics if is_cloud(topic)} - ({MERGED_TOPIC} - given.keys())
        window = collect_frames(recording, topics, config, label, find_time_range(recording, config, label, given))
        require_frames(window, given, config, label)
    except InputError as error:
        return given, window, str(error)
    return given, window, ""


def _cloud_summary(
    topic: Topic, frames: Sequence[Cloud], span: Span | None, snapshot: Snapshot, since_ns: int
) -> CloudTopicSummary:
    lidar = next((lidar.name for lidar in snapshot.lidars if lidar.topic == topic.name), "")
    ranges_m = [np.linalg.norm(frame.scan.points_m.astype(np.float64), axis=1) for frame in frames]
    ranges_m = [each_m[each_m > 0.0] for each_m in ranges_m]
    counts = [len(each_m) for each_m in ranges_m] or [0]
    joined_m = np.concatenate([*ranges_m, np.empty(0)])
    first_ns, last_ns = (max(span[0], min(since_ns, span[1])), span[1]) if span else (None, None)
    return CloudTopicSummary(
        topic=topic.name,
        message_type=topic.message_type,
        frame_id=frames[0].frame_id if frames else "",
        lidar=lidar,
        frames=topic.count,
        frames_taken=len(frames) if lidar else 0,
        rate_hz=_rate_hz(topic, frames, span, since_ns),
        points_min=min(counts),
        points_median=int(np.median(counts)),
        points_max=max(counts),
        range_median_m=float(np.median(joined_m)) if joined_m.size else None,
        range_max_m=float(joined_m.max()) if joined_m.size else None,
        first_ns=first_ns,
        last_ns=last_ns,
    )


def _rate_hz(topic: Topic, frames: Sequence[Cloud], span: Span | None, since_ns: int) -> float | None:
    """Return the mean rate; that of the frames of the window if some scans were recorded before the clock was set."""
    if topic.count < 2 or span is None or span[1] <= span[0]:
        return None
    if span[0] >= since_ns:
        # All turns lie between the first and the last packet, but one less between the first and the last scan.
        periods = topic.count if topic.encoding == OUSTER_TURN else topic.count - 1
        return periods * _NS_PER_S / (span[1] - span[0])
    steps_ns = np.diff(sorted(frame.scan.log_time_ns for frame in frames))
    return float(_NS_PER_S / np.median(steps_ns)) if steps_ns.size and 0 < np.median(steps_ns) < _NS_PER_S else None
