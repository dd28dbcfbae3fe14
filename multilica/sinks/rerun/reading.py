# SPDX-License-Identifier: Apache-2.0
"""Reader of recordings, whole or cut off."""

import shutil
import struct
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from multilica.errors import UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.results.document import ResultDocument, parse_result
from multilica.sinks.rerun.entity_paths import RESULT, lidar_path, pair_path

__all__ = ["RecordedScores", "read_recorded_cloud", "read_recorded_document", "read_recorded_scores"]

_TEXT = "TextDocument:text"
_POSITIONS = "Points3D:positions"
_CLASSES = "Points3D:class_ids"
_STEP = "step"

# An RRD file is a head, then messages: kind and length, 64 bits each, little-endian, then so many bytes. A message of
# kind 0 ends the stream; the reader refuses a file that ends within a message.
_MAGIC = b"RRF2"
_HEAD_BYTES = 12
_MESSAGE_HEAD = struct.Struct("<QQ")
_KNOWN_KINDS = range(1, 4)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScores:
    """Scored points of a pair's source.

    Args:
        points_m: (N, 3) in the source's frame; empty if the recording has none.
        labels: (N,) `BeamLabel` per pose, the latest first: the registrations by evidence, then the hypotheses.
        competing_pose: `T_target_source` of the competing pose, if there is one.
    """

    points_m: npt.NDArray[np.float32]
    labels: tuple[npt.NDArray[np.uint8], ...]
    competing_pose: RigidTransform | None


def read_recorded_document(path: Path) -> ResultDocument:
    """Read the latest result document of a recording.

    Raises:
        UnreadableSourceError: no recording, or cut off before the first stage ended.
    """
    texts = _cells(_batches(path, RESULT), _TEXT)
    if not texts:
        raise UnreadableSourceError(
            f"{path} has no {RESULT}, which `multilica calibrate` writes when its first stage ends; give the recording "
            "of a run."
        )
    return max((parse_result(path, text[0]) for text in reversed(texts)), key=_progress)


def _progress(document: ResultDocument) -> tuple[bool, int]:
    """Order the documents of a run; several may be logged at one step."""
    return document.status != "unfinished", len(document.progress.finished) if document.progress is not None else 0


def read_recorded_cloud(path: Path, lidar: str) -> npt.NDArray[np.float32]:
    """Read the preprocessed points (N, 3) of a LiDAR in its own frame; none if the recording has none.

    Raises:
        UnreadableSourceError: no recording.
    """
    return _points_m(_cells(_batches(path, lidar_path(lidar, "preprocessed")), _POSITIONS))


def read_recorded_scores(path: Path, target: str, source: str) -> RecordedScores:
    """Read the scored points of a pair's source, in either order of the pair.

    Raises:
        UnreadableSourceError: no recording.
    """
    scored = _batches(path, pair_path(target, source, "scored", "source"))
    competing_pose = _competing(path, target, source)
    if not scored:
        scored = _batches(path, pair_path(source, target, "scored", "target"))
        reverse = _competing(path, source, target)
        competing_pose = None if reverse is None else reverse.inverse()
    labels = [np.asarray(cell, dtype=np.uint8) for cell in reversed(_cells(scored, _CLASSES))]
    return RecordedScores(_points_m(_cells(scored, _POSITIONS)), tuple(labels), competing_pose)


def _competing(path: Path, target: str, source: str) -> RigidTransform | None:
    batches = _batches(path, pair_path(target, source, "competing", "pose"))
    translations, quaternions = (_cells(batches, f"Transform3D:{part}") for part in ("translation", "quaternion"))
    if not translations or not quaternions:
        return None
    return RigidTransform.from_xyz_quaternion(target, source, translations[-1][0], quaternions[-1][0])


def _points_m(cells: list[Any]) -> npt.NDArray[np.float32]:
    """Return the points (N, 3) of the last cell; none without cells."""
    return np.asarray(cells[-1], dtype=np.float32).reshape(-1, 3) if cells else np.empty((0, 3), dtype=np.float32)


def _cells(batches: list[Any], column: str) -> list[Any]:
    """Return the cells of a column in order of steps: rows of a file are not in order of time."""
    found = [
        (step, cell)
        for batch in batches
        if column in batch.schema.names
        for step, cell in zip(batch.column(_STEP).to_pylist(), batch.column(column).to_pylist(), strict=True)
        if cell
    ]
    return [cell for _, cell in sorted(found, key=lambda each: each[0])]


def _batches(path: Path, entity: str) -> list[Any]:
    """Return everything logged to one entity; of a file that was cut off, all before the cut."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        try:
            with _whole_part(path) as whole:
                chunks = RrdReader(whole).stream().filter(content=entity).to_chunks()
        except (ValueError, OSError, RuntimeError) as error:
            raise UnreadableSourceError(f"{path} is not a recording that can be read: {error}.") from error
    return [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == entity]


@contextmanager
def _whole_part(path: Path) -> Iterator[Path]:
    """Provide a file with all complete messages of a recording: the file itself if it was not cut off.

    A file that is no recording is provided as it is, and the reader refuses it.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        end = _end_of_whole_messages(file, size)
        if end is None:
            yield path
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            file.seek(0)
            with copy.open("wb") as kept:
                shutil.copyfileobj(file, kept)
                kept.truncate(end)
            yield copy


def _end_of_whole_messages(file: BinaryIO, size: int) -> int | None:
    """Return where the last complete message ends; None if the file is complete, or no recording."""
    if file.read(_HEAD_BYTES)[: len(_MAGIC)] != _MAGIC:
        return None
    at = _HEAD_BYTES
    while at < size:
        file.seek(at)
        head = file.read(_MESSAGE_HEAD.size)
        if len(head) < _MESSAGE_HEAD.size:
            return at
        kind, length = _MESSAGE_HEAD.unpack(head)
        after = at + _MESSAGE_HEAD.size + length
        if kind == 0 and after <= size:
            return None
        if kind not in _KNOWN_KINDS or after > size:
            return at
        at = after
    return None
