# SPDX-License-Identifier: Apache-2.0
"""What a recording tells of its run, whole or cut off."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.errors import UnreadableSourceError
from multilica.sinks.rerun_tree import RESULT, lidar_path
from multilica.sinks.rerun_whole_part import whole_part

__all__ = ["read_recorded_cloud", "read_recorded_document"]

_TEXT = "TextDocument:text"
_POSITIONS = "Points3D:positions"


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
    clouds = [
        np.asarray(cell, dtype=np.float32).reshape(-1, 3)
        for batch in _batches(path, lidar_path(lidar, "preprocessed"))
        if _POSITIONS in batch.schema.names
        for cell in batch.column(_POSITIONS).to_pylist()
        if cell
    ]
    return clouds[-1] if clouds else np.empty((0, 3), dtype=np.float32)


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
