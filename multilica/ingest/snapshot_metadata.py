# SPDX-License-Identifier: Apache-2.0
"""The metadata that `multilica record` saves in a snapshot."""

import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from multilica.config import IngestConfig
from multilica.documents import DocumentError, parse_json
from multilica.ingest.containers.mcap_metadata import mcap_metadata
from multilica.ingest.locate import PathLike, locate
from multilica.ingest.recording import sanitize_text
from multilica.ingest.remote.address import is_live
from multilica.ingest.remote.remote_file import SourceFile
from multilica.pointcloud2 import SNAPSHOT_METADATA_NAME

_PREFIX = "When it was recorded: "
_MAX_FRAMES = 1_000_000


def _frames(text: object) -> object:
    """Return the number of frames in the text of it; 0 for anything else."""
    return int(text) if isinstance(text, str) and re.fullmatch("[0-9]{1,7}", text) else 0


def _list(text: object) -> object:
    """Return the list in a JSON text; an empty one for anything else."""
    try:
        found = parse_json(text) if isinstance(text, str) else None
    except DocumentError:
        found = None
    return found if isinstance(found, list) else []


class SnapshotMetadata(BaseModel):
    """The metadata record of a snapshot; `frames` is 0 if they are not known."""

    model_config = ConfigDict(frozen=True)

    frames: Annotated[int, BeforeValidator(_frames), Field(le=_MAX_FRAMES)] = 0
    notes: Annotated[tuple[object, ...], BeforeValidator(_list)] = ()


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
    counts = [_metadata(locate(source)).frames for source in sources]
    return max(counts) if counts and all(counts) else None


def notes_recorded(files: Sequence[SourceFile], known: Collection[str]) -> list[str]:
    """Return the notes saved when the snapshots were taken, without the known ones."""
    notes = [note for file in files for note in _notes(file) if note not in known]
    return [note if note.startswith(_PREFIX) else f"{_PREFIX}{note}" for note in notes]


def _notes(path: SourceFile) -> list[str]:
    return [" ".join(sanitize_text(note).split()) for note in _metadata(path).notes if isinstance(note, str)]


def _metadata(path: SourceFile) -> SnapshotMetadata:
    """Return the metadata; empty for every other file, and for a file that cannot be read, which fails later."""
    with suppress(ValidationError):
        return SnapshotMetadata.model_validate(_texts(path))
    return SnapshotMetadata()


def _texts(path: SourceFile) -> dict[str, str]:
    return next((record.metadata for record in mcap_metadata(path) if record.name == SNAPSHOT_METADATA_NAME), {})
