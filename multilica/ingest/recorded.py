# SPDX-License-Identifier: Apache-2.0
"""What a snapshot that `multilica record` took says about itself."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from contextlib import closing
from io import BytesIO
from typing import IO, cast

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Metadata

from multilica.config import IngestConfig
from multilica.ingest.address import is_live
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.detect import named_format
from multilica.ingest.encodable import encodable
from multilica.ingest.mcap_records import RECORD_HEAD
from multilica.ingest.remote_file import SourceFile
from multilica.ingest.source import PathLike, locate
from multilica.ingest.whole_reads import WholeReads
from multilica.pointcloud2 import SNAPSHOT_METADATA_NAME

__all__ = ["config_for", "frames_recorded", "notes_recorded"]

_MAX_BYTES = 1 << 20
"""Of a snapshot's metadata, which takes a few hundred."""
_THEN = "When it was recorded: "


def config_for(sources: Sequence[PathLike]) -> IngestConfig:
    """What is taken where nobody says otherwise: all of a snapshot, the usual number of frames of anything else."""
    frames = frames_recorded(sources)
    return IngestConfig() if frames is None else IngestConfig(frames=frames)


def frames_recorded(sources: Sequence[PathLike]) -> int | None:
    """Frames per LiDAR that were asked for when `multilica record` took these snapshots, the most of any.

    None unless all of them are such snapshots.
    """
    if any(map(is_live, sources)):
        return None
    counts = [_frames_of(locate(source)) for source in sources]
    return max((count for count in counts if count), default=None) if all(counts) else None


def notes_recorded(files: Sequence[SourceFile], known: Collection[str]) -> list[str]:
    """What was noticed when these snapshots were taken, without what is known anyway."""
    notes = [note for file in files for note in _notes_of(file) if note not in known]
    return [note if note.startswith(_THEN) else f"{_THEN}{note}" for note in notes]


def _frames_of(path: SourceFile) -> int | None:
    text = _told(path).get("frames", "")
    return int(text) if text.isdecimal() else None


def _notes_of(path: SourceFile) -> list[str]:
    try:
        notes = json.loads(_told(path).get("notes", "[]"))
    except (ValueError, RecursionError):
        return []
    return (
        [" ".join(encodable(note).split()) for note in notes if isinstance(note, str)]
        if isinstance(notes, list)
        else []
    )


def _told(path: SourceFile) -> dict[str, str]:
    """Nothing of every other file, and of one that cannot be read: who reads it will say why."""
    try:
        with damage_named(str(path)):
            if named_format(path) != "mcap" or not (path.exists() and path.is_file()):
                return {}
            with closing(WholeReads.of_file(path)) as stream:
                return _metadata(stream)
    except DamagedRecordingError:
        return {}


def _metadata(stream: WholeReads) -> dict[str, str]:
    summary = make_reader(cast(IO[bytes], stream)).get_summary()
    for index in summary.metadata_indexes if summary else ():
        if index.name == SNAPSHOT_METADATA_NAME and index.length <= _MAX_BYTES:
            stream.seek(index.offset + RECORD_HEAD.size)
            record = stream.read(index.length - RECORD_HEAD.size)
            entries: dict[str, str] = Metadata.read(ReadDataStream(BytesIO(record))).metadata
            return entries
    return {}
