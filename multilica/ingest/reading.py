# SPDX-License-Identifier: Apache-2.0
"""From a source to the snapshot in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

from multilica.config import IngestConfig
from multilica.ingest.choice import choose_topics, unread_notes
from multilica.ingest.encodable import encodable
from multilica.ingest.fingerprint import sha256_of_files
from multilica.ingest.naming import lidar_names, shared_frames
from multilica.ingest.opening import open_source
from multilica.ingest.recorded import config_for, notes_recorded
from multilica.ingest.recording import Recording
from multilica.ingest.remote_file import SourceFile
from multilica.ingest.source import PathLike, find_source
from multilica.ingest.static_transforms import StaticTransforms, read_static_transforms
from multilica.ingest.window import Window, collect_frames, require_frames
from multilica.snapshot import LidarScans, Snapshot

__all__ = ["DEFAULT_CONFIG", "assemble_snapshot", "read_snapshot", "with_recorded_notes"]

DEFAULT_CONFIG = IngestConfig()


def read_snapshot(source: PathLike | Sequence[PathLike], *, config: IngestConfig | None = None) -> Snapshot:
    """Read what each LiDAR of a recording saw in one window of time.

    Args:
        source: an MCAP file, a ROS 2 bag (folder, ``.db3`` or ``.mcap``), a ROS 1 bag, a folder of point files with one
            per LiDAR or one sub-folder of frames per LiDAR, or a list: of point files and folders of them, or of
            recordings with different LiDARs each.
        config: which topics, from when on, how many frames; None: the defaults, but all of what `multilica record`
            took.

    Returns:
        The snapshot, points in the order of the recording; notes say what could not be read.

    Raises:
        SourceNotFoundError: nothing at that path.
        UnreadableSourceError: empty, broken, or not what its name says.
        UnfitSnapshotError: no point clouds, or none in the window.
        UnknownNameError: no point cloud topic of that name.
        UsageError: several recordings of the same LiDAR, or a topic with two names.
    """
    found = find_source(source)
    config = config or config_for(found.files)
    with ThreadPoolExecutor(max_workers=1) as aside, closing(open_source(found)) as recording:
        # Hashing takes as long as unpacking and holds no lock on Python.
        sha256 = aside.submit(sha256_of_files, found.files)
        given = choose_topics(recording, config.topics, found.label, config.only)
        window = collect_frames(recording, given.keys(), config, found.label)
        require_frames(window, given.keys(), config, found.label)
        static = read_static_transforms(recording)
        unread = unread_notes(recording)
        snapshot = assemble_snapshot(found.label, given, window, static, sha256.result(), unread)
        return with_recorded_notes(snapshot, recording, found.files)


def assemble_snapshot(
    label: str,
    given: Mapping[str, str],
    window: Window,
    static: StaticTransforms,
    sha256: str = "",
    notes: Sequence[str] = (),
) -> Snapshot:
    """Name the LiDARs that were taken.

    Args:
        label: the source as the user named it.
        given: topic -> name, empty where the frame id is to give it; other topics of the window are left out.
        notes: more that the user should know.
    """
    clouds = {topic: frames for topic, frames in window.clouds.items() if topic in given}
    frame_ids = {topic: frames[0].frame_id for topic, frames in clouds.items()}
    names = lidar_names({topic: given[topic] for topic in clouds}, frame_ids)
    lidars = [
        LidarScans(names[topic], tuple(cloud.scan for cloud in frames), frame_ids[topic], encodable(topic))
        for topic, frames in clouds.items()
    ]
    return Snapshot(
        lidars=tuple(lidars),
        source=encodable(label),
        source_sha256=sha256,
        static_transforms=static[0],
        notes=tuple(map(encodable, (*window.notes, *static[1], *_frame_notes(frame_ids), *notes))),
    )


def with_recorded_notes(snapshot: Snapshot, recording: Recording, files: Sequence[SourceFile]) -> Snapshot:
    """With what was noticed when `multilica record` took it, if it did."""
    # Only what multilica wrote names its LiDARs.
    if not any(topic.lidar for topic in recording.topics):
        return snapshot
    return replace(snapshot, notes=(*snapshot.notes, *notes_recorded(files, snapshot.notes)))


def _frame_notes(frame_ids: Mapping[str, str]) -> list[str]:
    return [
        f"{', '.join(topics)} have the same frame id '{frame_id}'; if their points were already taken to one frame, "
        "the result is the correction, not the pose of the sensors."
        for frame_id, topics in shared_frames(frame_ids).items()
    ]
