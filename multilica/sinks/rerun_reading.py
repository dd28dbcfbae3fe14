# SPDX-License-Identifier: Apache-2.0
"""What a recording tells of its run, whole or cut off."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.errors import UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.sinks.rerun_tree import RESULT, lidar_path, pair_path
from multilica.sinks.rerun_whole_part import whole_part

__all__ = ["RecordedJudgement", "read_recorded_cloud", "read_recorded_document", "read_recorded_judgement"]

_TEXT = "TextDocument:text"
_POSITIONS = "Points3D:positions"
_CLASSES = "Points3D:class_ids"
_STEP = "step"


@dataclass(frozen=True, slots=True, eq=False)
class RecordedJudgement:
    """What a recording holds of the points of a pair's source that the target's beams judged.

    Args:
        points_m: (N, 3) in the source's frame; none if the recording has none.
        labels: per pose, the latest first, (N,) `BeamLabel`; the latest are the finalists, the chosen one first.
        rival: `T_target_source` of the other pose, where two cannot be told apart.
    """

    points_m: npt.NDArray[np.float32]
    labels: tuple[npt.NDArray[np.uint8], ...]
    rival: RigidTransform | None


def read_recorded_document(path: Path) -> Mapping[str, Any]:
    """The latest result document that the recording holds.

    Raises:
        UnreadableSourceError: no recording, or cut off before the first stage ended.
    """
    latest: str | None = None
    for batch in _batches(path, RESULT):
        if _TEXT in batch.schema.names:
            texts = [cell[0] for cell in batch.column(_TEXT).to_pylist() if cell]
            latest = max([*texts, latest or ""], key=_progress)
    if not latest:
        raise UnreadableSourceError(
            f"{path} does not tell of a run: it has no {RESULT}, which `multilica calibrate` writes when its first "
            "stage ends; give the recording of a run."
        )
    return dict(json.loads(latest))


def _progress(text: str) -> tuple[bool, int]:
    """Whether it is of an ended run, and how many stages had finished: the order of rows in a file is not time's."""
    document = json.loads(text or "{}")
    return document.get("status", "unfinished") != "unfinished", len(document.get("progress", {}).get("finished", ()))


def read_recorded_cloud(path: Path, lidar: str) -> npt.NDArray[np.float32]:
    """(N, 3) preprocessed points of a LiDAR in its own frame, as the recording shows them; none if it has none.

    Raises:
        UnreadableSourceError: no recording.
    """
    return _points_m(_cells(_batches(path, lidar_path(lidar, "preprocessed")), _POSITIONS))


def read_recorded_judgement(path: Path, target: str, source: str) -> RecordedJudgement:
    """The judged points of a pair's source, whichever way round the pair was matched.

    Raises:
        UnreadableSourceError: no recording.
    """
    judged, rival = _batches(path, pair_path(target, source, "judged", "source")), _rival(path, target, source)
    if not judged:
        judged, rival = _batches(path, pair_path(source, target, "judged", "target")), _rival(path, source, target)
        rival = rival.inverse() if rival is not None else None
    labels = [np.asarray(cell, dtype=np.uint8) for cell in reversed(_cells(judged, _CLASSES))]
    return RecordedJudgement(_points_m(_cells(judged, _POSITIONS)), tuple(labels), rival)


def _rival(path: Path, target: str, source: str) -> RigidTransform | None:
    """The other pose of a pair as it was matched."""
    batches = _batches(path, pair_path(target, source, "rival", "pose"))
    translations, quaternions = (_cells(batches, f"Transform3D:{part}") for part in ("translation", "quaternion"))
    if not translations or not quaternions:
        return None
    return RigidTransform.from_xyz_quaternion(target, source, translations[-1][0], quaternions[-1][0])


def _points_m(cells: list[Any]) -> npt.NDArray[np.float32]:
    """(N, 3) of the last cell; none without cells."""
    return np.asarray(cells[-1], dtype=np.float32).reshape(-1, 3) if cells else np.empty((0, 3), dtype=np.float32)


def _cells(batches: list[Any], column: str) -> list[Any]:
    """What was logged of one component, in the order of steps: that of rows in a file is not time's."""
    found = [
        (step, cell)
        for batch in batches
        if column in batch.schema.names
        for step, cell in zip(batch.column(_STEP).to_pylist(), batch.column(column).to_pylist(), strict=True)
        if cell
    ]
    return [cell for _, cell in sorted(found, key=lambda each: each[0])]


def _batches(path: Path, entity: str) -> list[Any]:
    """What was logged to one entity; the part before the cut of a file that was cut off."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        try:
            with whole_part(path) as whole:
                chunks = RrdReader(whole).stream().filter(content=entity).to_chunks()
        except (ValueError, OSError, RuntimeError) as error:
            raise UnreadableSourceError(f"{path} is not a recording that can be read: {error}.") from error
    return [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == entity]
