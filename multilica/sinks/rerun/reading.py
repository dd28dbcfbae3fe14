# SPDX-License-Identifier: Apache-2.0
"""Reader of what recordings hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.errors import UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.results import PairKey
from multilica.results.document import ResultDocument, parse_result
from multilica.sinks.rerun.entity_paths import RESULT, lidar_path, pair_path
from multilica.sinks.rerun.rrd_process import read_batches

_TEXT = "TextDocument:text"
_POSITIONS = "Points3D:positions"
_CLASSES = "Points3D:class_ids"
_STEP = "step"


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScores:
    """Scored points of a pair.

    Args:
        points_m: (N, 3) of the source, in its own frame; empty if the recording has none.
        labels: (N,) `BeamLabel` per pose, the latest first: the registrations by evidence, then the hypotheses.
        target_points_m, target_labels: the same of the target.
        competing_pose: `T_target_source` of the competing pose, if there is one.
    """

    points_m: npt.NDArray[np.float32]
    labels: tuple[npt.NDArray[np.uint8], ...]
    target_points_m: npt.NDArray[np.float32]
    target_labels: tuple[npt.NDArray[np.uint8], ...]
    competing_pose: RigidTransform | None


def read_recorded_document(path: Path) -> ResultDocument:
    """Read the latest result document of a recording.

    Raises:
        UnreadableSourceError: no recording, or cut off before the first stage ended.
    """
    texts = _cells(read_batches(path, [RESULT])[RESULT], _TEXT)
    if not texts:
        raise UnreadableSourceError(
            f"{path} has no {RESULT}, which `multilica calibrate` writes when its first stage ends; give the recording "
            "of a run."
        )
    return max((parse_result(path, text[0]) for text in reversed(texts)), key=_progress)


def _progress(document: ResultDocument) -> tuple[bool, int]:
    """Order the documents of a run; several may be logged at one step."""
    return document.status != "unfinished", len(document.progress.finished) if document.progress is not None else 0


def read_recorded_clouds(path: Path, lidars: Sequence[str]) -> dict[str, npt.NDArray[np.float32]]:
    """Read the preprocessed points (N, 3) of LiDARs, each in its own frame; none if the recording has none.

    Raises:
        UnreadableSourceError: no recording, or a damaged one.
    """
    places = {lidar: lidar_path(lidar, "preprocessed") for lidar in lidars}
    found = read_batches(path, list(places.values()))
    return {lidar: _points_m(_cells(found[place], _POSITIONS)) for lidar, place in places.items()}


def read_recorded_scores(path: Path, pairs: Sequence[PairKey]) -> dict[PairKey, RecordedScores]:
    """Read the scored points of each pair (target, source), in either order of the pair.

    Raises:
        UnreadableSourceError: no recording, or a damaged one.
    """
    kinds = (("scored", "source"), ("scored", "target"), ("competing", "pose"))
    both_ways = [key for target, source in pairs for key in ((target, source), (source, target))]
    found = read_batches(path, [pair_path(*key, *kind) for key in both_ways for kind in kinds])
    return {pair: _scores(found, *pair) for pair in pairs}


def _scores(found: Mapping[str, list[Any]], target: str, source: str) -> RecordedScores:
    ends = [found[pair_path(target, source, "scored", end)] for end in ("source", "target")]
    competing_pose = _competing(found, target, source)
    if not ends[0]:
        ends = [found[pair_path(source, target, "scored", end)] for end in ("target", "source")]
        reverse = _competing(found, source, target)
        competing_pose = None if reverse is None else reverse.inverse()
    (points_m, labels), (target_points_m, target_labels) = map(_labelled, ends)
    return RecordedScores(points_m, labels, target_points_m, target_labels, competing_pose)


def _labelled(scored: list[Any]) -> tuple[npt.NDArray[np.float32], tuple[npt.NDArray[np.uint8], ...]]:
    labels = (np.asarray(cell, dtype=np.uint8) for cell in reversed(_cells(scored, _CLASSES)))
    return _points_m(_cells(scored, _POSITIONS)), tuple(labels)


def _competing(found: Mapping[str, list[Any]], target: str, source: str) -> RigidTransform | None:
    batches = found[pair_path(target, source, "competing", "pose")]
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
