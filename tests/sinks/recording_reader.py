# SPDX-License-Identifier: Apache-2.0
"""What lies in a `.rrd` file, with or without its footer."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import pyarrow as pa
from rerun.chunk import RrdReader

FRAME_COLUMNS = ("CoordinateFrame:frame", "Transform3D:child_frame", "Transform3D:parent_frame")


class Recording:
    """Rows of a recording by entity path; a cell is what one `log` call gave one component."""

    def __init__(self, path: Path) -> None:
        self.chunks = _open(path).stream().to_chunks()
        self._rows: dict[str, list[dict[str, Any]]] = {}

    def rows(self, path: str) -> list[dict[str, Any]]:
        """The rows of one path; those of clouds take long."""
        if path not in self._rows:
            chunks = (chunk for chunk in self.chunks if chunk.entity_path == path)
            self._rows[path] = [row for chunk in chunks for row in _untimed(chunk)]
        return self._rows[path]

    @property
    def entity_paths(self) -> set[str]:
        return {chunk.entity_path for chunk in self.chunks if not chunk.entity_path.startswith("/__properties")}

    @property
    def timelines(self) -> set[str]:
        return {name for chunk in self.chunks for name in chunk.timeline_names}

    @property
    def frames(self) -> set[str]:
        batches = [chunk.to_record_batch() for chunk in self.chunks]
        columns = [batch.column(name) for batch in batches for name in FRAME_COLUMNS if name in batch.schema.names]
        return {frame for column in columns for cell in column.to_pylist() for frame in cell or ()}

    @property
    def log(self) -> list[tuple[int, str, str]]:
        """(step, level, text) in order."""
        rows = sorted(self.rows("/log"), key=lambda row: row["step"])
        return [(row["step"], row["TextLog:level"][0], row["TextLog:text"][0]) for row in rows]

    def properties(self) -> dict[str, str]:
        """The last value of each."""
        found: dict[str, str] = {}
        for row in self.rows("/__properties/multilica"):
            found |= {name: cell[0] for name, cell in row.items() if isinstance(cell, list) and cell}
        return found

    def cells(self, path: str, column: str, timeline: str = "step") -> list[tuple[int, Any]]:
        """(time, cell) of every row that has something in that column, in order."""
        rows = [(row[timeline], row[column]) for row in self.rows(path) if row.get(column) and timeline in row]
        return sorted(rows, key=lambda row: row[0])

    def last(self, path: str, column: str) -> Any:
        """The cell of the highest step."""
        return self.cells(path, column)[-1][1]


def _open(path: Path) -> RrdReader:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        return RrdReader(path)


def _untimed(chunk: Any) -> list[dict[str, Any]]:
    batch = chunk.to_record_batch()
    names = [name for name in batch.schema.names if not pa.types.is_timestamp(batch.schema.field(name).type)]
    return batch.select(names).to_pylist()


def blueprint_names(path: Path) -> list[set[str]]:
    """Per blueprint of a recording, the smallest first, the names of its views and containers."""
    reader = _open(path)
    return sorted((_names(reader.stream(store=store).to_chunks()) for store in reader.blueprints()), key=len)


def _names(chunks: list[Any]) -> set[str]:
    names = set()
    for chunk in chunks:
        batch = chunk.to_record_batch()
        for column in ("ViewBlueprint:display_name", "ContainerBlueprint:display_name"):
            if column in batch.schema.names:
                names |= {cell[0] for cell in batch.column(column).to_pylist() if cell}
    return names
