# SPDX-License-Identifier: Apache-2.0
"""Metadata of recordings: those that `multilica record` saves, vehicle and time of a log."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from multilica.config import IngestConfig
from multilica.documents import MAX_YAML_BYTES, DocumentError, parse_json, parse_yaml
from multilica.errors import MultilicaError, SourceNotFoundError
from multilica.ingest.containers.mcap_file import mcap_metadata
from multilica.ingest.locate import PathLike, find_source, locate
from multilica.ingest.memory import limited_memory
from multilica.ingest.opening import open_source
from multilica.ingest.recording import DamagedRecordingError, Recording, Span, sanitize_text
from multilica.ingest.remote.address import is_live
from multilica.ingest.remote.remote_file import ConnectionLostError, SourceFile
from multilica.pointcloud2 import SNAPSHOT_METADATA_NAME
from multilica.snapshot import Snapshot

_PREFIX = "When it was recorded: "
_MAX_FRAMES = 1_000_000

VEHICLE_KEYS = ("vehicle", "vehicle_id", "vehicle_name", "robot", "robot_id")
"""Keys, in any metadata record of an MCAP file or in `custom_data` of a ROS 2 bag, of the vehicle's name."""


def config_for(sources: Sequence[PathLike]) -> IngestConfig:
    """Return the defaults; for recorded snapshots, with all of their frames."""
    frames = frames_recorded(sources)
    return IngestConfig() if frames is None else IngestConfig(frames=frames)


def frames_recorded(sources: Sequence[PathLike]) -> int | None:
    """Return the largest number of frames per LiDAR that `multilica record` was asked for.

    None unless all sources are such snapshots.
    """
    if any(map(is_live, sources)):
        return None
    counts = [_frames(_snapshot_metadata(locate(source))) for source in sources]
    return max(counts) if counts and all(counts) else None


def stops_recorded(sources: Sequence[SourceFile]) -> tuple[Span, ...]:
    """Return the log times of the stops that `multilica record` saved in a file, oldest first; none for others."""
    if len(sources) != 1:
        return ()
    try:
        spans = parse_json(_snapshot_metadata(sources[0]).get("stops", "[]"))
        return tuple(sorted((int(first_ns), int(last_ns)) for first_ns, last_ns in spans if first_ns <= last_ns))
    except (DocumentError, TypeError, ValueError):
        return ()


def with_recorded_notes(snapshot: Snapshot, recording: Recording, files: Sequence[SourceFile]) -> Snapshot:
    """Add the notes that `multilica record` saved when the snapshot was taken."""
    # Only multilica's own recordings name their LiDARs.
    if not any(topic.lidar for topic in recording.topics):
        return snapshot
    notes = [note for file in files for note in _notes(_snapshot_metadata(file)) if note not in snapshot.notes]
    told = [note if note.startswith(_PREFIX) else f"{_PREFIX}{note}" for note in notes]
    return replace(snapshot, notes=(*snapshot.notes, *told))


def _frames(saved: Mapping[str, str]) -> int:
    """Return the number of frames; 0 if there is no valid one."""
    text = saved.get("frames", "")
    frames = int(text) if re.fullmatch("[0-9]{1,7}", text) else 0
    return frames if frames <= _MAX_FRAMES else 0


def _notes(saved: Mapping[str, str]) -> list[str]:
    with suppress(DocumentError):
        notes = parse_json(saved.get("notes", ""))
        return [" ".join(sanitize_text(note).split()) for note in notes if isinstance(note, str)]
    return []


def _snapshot_metadata(path: SourceFile) -> Mapping[str, str]:
    """Return the record of a snapshot; empty for other files, and for a file that cannot be read, which fails later."""
    return next((record.metadata for record in mcap_metadata(path) if record.name == SNAPSHOT_METADATA_NAME), {})


@dataclass(frozen=True, slots=True)
class LogIdentity:
    """Vehicle, empty if the log does not say it, and time of the first message, None if it has none."""

    vehicle: str
    time_ns: int | None


def identify_log(source: PathLike) -> LogIdentity:
    """Read vehicle and time of a log, as far as it can be read.

    Raises:
        ConnectionLostError: a server does not answer.
    """
    vehicle, time_ns = "", None
    try:
        file = locate(source)
        vehicle = next((texts[key] for texts in _metadata(file) for key in VEHICLE_KEYS if texts.get(key)), "")
        found = find_source(file)
        with limited_memory(IngestConfig().max_memory_mb, found.label), closing(open_source(found)) as recording:
            span = recording.span_ns([topic.name for topic in recording.topics])
            time_ns = span[0] if span and 0 < span[0] < 2**63 else None
    except ConnectionLostError:
        raise
    except (MultilicaError, DamagedRecordingError, OSError):
        pass
    return LogIdentity(sanitize_text(vehicle), time_ns)


def _metadata(file: SourceFile) -> Iterator[Mapping[str, str]]:
    if file.is_dir():
        yield _custom_data(file / "metadata.yaml")
        return
    yield from (record.metadata for record in mcap_metadata(file))
    if isinstance(file, Path):
        yield _custom_data(file.parent / "metadata.yaml")


def _custom_data(path: SourceFile) -> Mapping[str, str]:
    with suppress(OSError, SourceNotFoundError, DocumentError, TypeError, KeyError, AttributeError):
        with path.open("rb") as file:
            data = file.read(MAX_YAML_BYTES + 1)
        values = parse_yaml(data)["rosbag2_bagfile_information"]["custom_data"]
        return {str(key): str(value) for key, value in values.items()}
    return {}
