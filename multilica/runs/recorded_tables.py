# SPDX-License-Identifier: Apache-2.0
"""Tables of a saved run: pairs, matches, merge decisions and timings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from multilica.runs.run_report import recording_of_run
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.rerun.reading import read_recorded_table

if TYPE_CHECKING:
    import pyarrow as pa


def table_of_run(path: Path, name: str) -> pa.Table:
    """Read a table from the recording of a run directory, or from a recording, complete or not.

    Args:
        name: ``pairs``, ``matches`` (of descriptors), ``surfaces`` (matches at the final pose), ``merge``, ``timings``.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: no recording, or a damaged one.
    """
    return read_recorded_table(recording_of_run(path), name)


def write_parquet(table: pa.Table, path: Path) -> None:
    """Write a table as Parquet; the file gets its name when it is complete."""
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        pq.write_table(table, file)
