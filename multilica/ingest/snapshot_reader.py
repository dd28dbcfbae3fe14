# SPDX-License-Identifier: Apache-2.0
"""The way from sources to their snapshots."""

import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UnreadableSourceError, UsageError, listed
from multilica.ingest.fingerprint import sha256_of_files
from multilica.ingest.live import LiveRecording, open_live
from multilica.ingest.locate import (
    PathLike,
    Source,
    are_stops,
    find_source,
    listed_names,
    locate,
    without_folders,
)
from multilica.ingest.memory import limited_memory
from multilica.ingest.merged_clouds import may_be_merged, merged_topics
from multilica.ingest.message_types import Cloud
from multilica.ingest.metadata import config_for, with_recorded_notes
from multilica.ingest.opening import open_source
from multilica.ingest.plausibility import plausibility_notes
from multilica.ingest.recording import MessageObserver, ProgressObserver, sanitize_text
from multilica.ingest.remote.address import is_live, require_valid, without_secrets
from multilica.ingest.selection.standstill import untold
from multilica.ingest.selection.time_range import TimeRange
from multilica.ingest.selection.topics import choose_topics, named_topics, unread_notes
from multilica.ingest.selection.window import Window, collect_frames, require_frames, require_separate
from multilica.ingest.transforms import StaticTransforms, read_static_transforms
from multilica.ros2 import Ros2Node
from multilica.snapshot import LidarScans, Snapshot


@dataclass(frozen=True, slots=True, eq=False)
class TakenSnapshot:
    """A snapshot with facts about its source.

    Args:
        source_bytes: size of the recording; None for a running vehicle.
        silent: chosen topics of a running vehicle that sent nothing readable.
    """

    snapshot: Snapshot
    source_bytes: int | None = None
    silent: tuple[str, ...] = ()


def take_snapshot(
    sources: Sequence[PathLike], *, config: IngestConfig | None = None, observe: MessageObserver | None = None
) -> TakenSnapshot:
    """Read a recording, or listen to a running vehicle.

    Args:
        sources: as for `read_snapshot`, or a single address of a running vehicle, as for `listen`.
        observe: called with each message of a running vehicle.

    Raises:
        MultilicaError: as `read_snapshot` or `listen`.
        UsageError: a running vehicle is given among other sources.
    """
    config = config or IngestConfig()
    live = live_address(sources)
    if live:
        return listen(live, config=config, observe=observe)
    files = [locate(source) for source in sources]
    snapshot = read_snapshot(files, config=config)
    return TakenSnapshot(snapshot, sum(file.stat().st_size for file in find_source(files).files))


def live_address(sources: Sequence[PathLike]) -> str:
    """Return the address of the running vehicle that is the source; empty for recordings.

    Raises:
        UsageError: it is given among other sources, or is not valid.
    """
    live = [str(source) for source in sources if is_live(source)]
    if not live:
        return ""
    if len(sources) > 1:
        raise UsageError(f"{without_secrets(live[0])} is given among other sources; give it alone.")
    require_valid(live[0])
    return live[0]


def read_snapshot(source: PathLike | Sequence[PathLike], *, config: IngestConfig | None = None) -> Snapshot:
    """Read the frames of each LiDAR of a recording in one time window.

    Args:
        source: an MCAP file, a ROS 2 bag (folder, ``.db3`` or ``.mcap``), a ROS 1 bag, a folder of point files with one
            file or one sub-folder of frames per LiDAR, or a list: of point files and folders of them, or of recordings
            with different LiDARs.
        config: topics, window and number of frames; None for the defaults, or for all frames of a snapshot that
            `multilica record` took.

    Returns:
        The snapshot, points in the order of the recording; its notes say what could not be read.

    Raises:
        SourceNotFoundError: nothing exists at that path.
        UnreadableSourceError: the source is empty, broken, or not what its name says.
        UnfitSnapshotError: there are no point clouds, or none in the window, or a topic holds those of several LiDARs.
        MemoryLimitError: reading takes more than `config.max_memory_mb`.
        UnknownNameError: there is no point cloud topic of that name.
        UsageError: several recordings or folders of the same LiDARs, or a topic with two names.
    """
    (snapshot,) = read_ranges([source] if isinstance(source, PathLike) else source, [None], config=config)
    return snapshot


def read_ranges(
    sources: Sequence[PathLike],
    ranges: Sequence[TimeRange | None],
    *,
    config: IngestConfig | None = None,
    observe: ProgressObserver = untold,
) -> tuple[Snapshot, ...]:
    """Read a snapshot of each time range of one recording, None for the configured one; arguments as `read_snapshot`.

    The limit of memory is that of all together. `observe` is called with each range.
    """
    start_s = time.perf_counter()
    paths = [locate(each) for each in sources]
    if are_stops(paths):
        raise UsageError(
            f"{listed_names(paths)} are several snapshots of one rig, with the same LiDARs; expected one of them, "
            "or all of them for `multilica calibrate`."
        )
    found = find_source(paths)
    config = config or config_for(found.files)
    if config.strict and found.faults:
        raise UnreadableSourceError(refused_as_strict(found))
    snapshots = []
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        given = choose_topics(recording, config.topics, found.label, config.only)
        static, unread, sha256 = (
            read_static_transforms(recording),
            [*found.notes, *unread_notes(recording)],
            sha256_of_files(found.files),
        )
        for times in ranges:
            window = collect_frames(recording, given.keys(), config, found.label, times)
            require_frames(window, given, config, found.label)
            snapshot = assemble_snapshot(
                found.label, given, window, static, sha256, unread, named_topics(given, config)
            )
            noted = with_recorded_notes(snapshot, recording, found.files)
            notes = without_folders(without_folders(noted.notes, found.files), paths)
            end_s = time.perf_counter()
            name = sanitize_text(listed_names(paths))
            snapshots.append(replace(noted, source=name, notes=notes, reading_s=end_s - start_s))
            observe(len(snapshots), len(ranges))
            start_s = end_s
    return tuple(snapshots)


def refused_as_strict(found: Source) -> str:
    """Return a sentence on files that are there in part, for `IngestConfig.strict`."""
    return f"{found.label} is refused, as ingest.strict is set: {found.faults[0]}"


def listen(
    url: str,
    *,
    config: IngestConfig | None = None,
    observe: MessageObserver | None = None,
    node: Ros2Node | None = None,
) -> TakenSnapshot:
    """Take `config.frames` frames of each LiDAR from a running vehicle.

    Stops when all frames have arrived, or after `config.timeout_s` with those that have. Goes on if a connection is
    lost or a node starts again.

    Args:
        url: ``ros2://`` for the nodes of a ROS 2 domain, or ``ws://`` or ``wss://`` for foxglove_bridge or a
            foxglove-sdk server.
        config: topics and number of frames; without topics, all point cloud topics that are offered at first.
        observe: called with each chosen topic and 0, then with each message.
        node: for ``ros2://``, one that stays open.

    Raises:
        UnreadableSourceError: nothing answers there.
        UnfitSnapshotError: there are no point clouds, or no LiDAR sends any, or several send on one topic; with
            `config.strict`, any fault.
        UnknownNameError: a topic is not offered in time.
        UsageError: a window is configured, or the address is not valid.
    """
    config = config or IngestConfig()
    report: MessageObserver = observe or (lambda _topic, _count: None)
    label = without_secrets(live_address([url]))
    with (
        limited_memory(config.max_memory_mb, label),
        closing(open_vehicle(url, config, report, node)) as recording,
    ):
        given = choose_topics(recording, config.topics, label, config.only)
        for topic in sorted(given):
            report(topic, 0)
        window = collect_frames(recording, given.keys(), config, label)
        if not window.clouds:
            raise UnfitSnapshotError(nothing_sent(label, given, config))
        require_separate(window, given)
        if config.strict and window.faults:
            raise UnfitSnapshotError(f"{label} is refused, as ingest.strict is set: {window.faults[0]}")
        static = read_static_transforms(recording)
        unread = [*unread_notes(recording), *recording.notes]
    silent = tuple(sorted(given.keys() - window.clouds.keys()))
    snapshot = assemble_snapshot(label, given, window, static, notes=unread, chosen=named_topics(given, config))
    return TakenSnapshot(snapshot, silent=silent)


def nothing_sent(label: str, topics: Iterable[str], config: IngestConfig) -> str:
    """Return a sentence on a running vehicle without scans."""
    return (
        f"{label} sent no readable scan on {listed(sorted(topics))} within {config.timeout_s:g} s; "
        "check that the LiDARs run, or give a longer --timeout."
    )


def open_vehicle(
    url: str, config: IngestConfig, observe: MessageObserver, node: Ros2Node | None = None
) -> LiveRecording:
    """Open a running vehicle, and wait until it offers the configured topics, or time is up.

    Raises:
        MultilicaError: as `open_live`.
        UsageError: a window is configured.
    """
    if config.start_s or config.start_at or config.window_s or config.window == "auto":
        label = without_secrets(url)
        raise UsageError(f"Found a window for {label}; a live snapshot begins now and takes one scan after the other.")
    recording = open_live(url, config.frames, config.timeout_s, observe, node)

    def is_offered() -> bool:
        with suppress(UnknownNameError, UnfitSnapshotError):
            choose_topics(recording, config.topics, "", config.only)
            return True
        return False

    try:
        recording.wait_for(is_offered)
    except BaseException:
        recording.close()
        raise
    return recording


def assemble_snapshot(
    label: str,
    given: Mapping[str, str],
    window: Window,
    static: StaticTransforms = ((), ()),
    sha256: str = "",
    notes: Sequence[str] = (),
    chosen: Collection[str] = (),
) -> Snapshot:
    """Name the LiDARs of a window: by the given name, else the frame id, else the topic.

    Clouds that were joined from those of several LiDARs are left out.

    Args:
        given: topic -> name, or empty; other topics of the window are left out.
        chosen: topics that are used even if their clouds were joined.
    """
    clouds, merged_notes = _without_merged(
        {topic: frames for topic, frames in window.clouds.items() if topic in given}, chosen
    )
    frame_ids = {topic: frames[0].frame_id for topic, frames in clouds.items()}
    topics_of: dict[str, list[str]] = defaultdict(list)
    for topic, frame_id in sorted(frame_ids.items()):
        topics_of[frame_id].append(topic)
    shared = {frame_id: topics for frame_id, topics in sorted(topics_of.items()) if frame_id and len(topics) > 1}
    names = _unique_names(
        {
            topic: given[topic] or ("" if frame_id in shared else frame_id) or topic.strip("/") or topic or "lidar"
            for topic, frame_id in sorted(frame_ids.items(), key=lambda item: (not given[item[0]], item[0]))
        }
    )
    frame_notes = [
        f"{listed(topics)} have the same frame id '{frame_id}'; if their points were already transformed to one "
        "frame, the result is the correction, not the pose of the sensors."
        for frame_id, topics in shared.items()
    ]
    lidars = tuple(
        LidarScans(names[topic], tuple(cloud.scan for cloud in frames), frame_ids[topic], sanitize_text(topic))
        for topic, frames in clouds.items()
    )
    doubts = plausibility_notes(sorted(lidars, key=lambda lidar: lidar.name), static[0])
    return Snapshot(
        lidars=lidars,
        source=sanitize_text(label),
        source_sha256=sha256,
        static_transforms=static[0],
        notes=tuple(map(sanitize_text, (*window.notes, *static[1], *merged_notes, *frame_notes, *doubts, *notes))),
    )


def _without_merged(
    clouds: dict[str, tuple[Cloud, ...]], chosen: Collection[str]
) -> tuple[dict[str, tuple[Cloud, ...]], list[str]]:
    """Return the clouds without those that were joined, and notes on these."""
    merged = merged_topics(clouds)
    notes: list[str] = []
    for topic in sorted(clouds):
        if topic in merged:
            use = "its pose will be of these" if topic in chosen else "it is left out; choose it with --topic to use it"
            notes.append(f"'{topic}' holds the points of {listed(merged[topic])}, moved by known poses: {use}.")
        elif may_be_merged(topic) and topic not in chosen and len(clouds) > 1:
            notes.append(
                f"'{topic}' is named like clouds joined from several LiDARs; leave it out with --topic if it is one: "
                "its pose would be that it was joined by."
            )
    return {topic: frames for topic, frames in clouds.items() if topic not in merged or topic in chosen}, notes


def _unique_names(wanted: Mapping[str, str]) -> dict[str, str]:
    """Number names that are taken already: ``roof``, ``roof_2``."""
    names: dict[str, str] = {}
    for topic, text in wanted.items():
        base = name = sanitize_text(text)
        number = 1
        while name in names.values():
            number += 1
            name = f"{base}_{number}"
        names[topic] = name
    return names


def require_calibratable(snapshot: Snapshot) -> None:
    """Raise UnfitSnapshotError unless at least two LiDARs have points."""
    source = snapshot.source or "The snapshot"
    if len(snapshot.lidars) < 2:
        only = f"only one LiDAR ({snapshot.names[0]})" if snapshot.names else "no LiDAR"
        left_out = "".join(f" {note}" for note in snapshot.notes if " is left out: " in note)
        raise UnfitSnapshotError(f"{source} has {only}; calibration needs at least two.{left_out}")
    empty = [lidar.name for lidar in snapshot.lidars if lidar.points_count == 0]
    filled = [lidar.name for lidar in snapshot.lidars if lidar.points_count > 0]
    if len(filled) < 2:
        raise UnfitSnapshotError(
            f"{source} has finite points of {', '.join(filled) or 'no LiDAR'} only, none of {', '.join(empty)}; "
            "calibration needs at least two LiDARs with points."
        )
