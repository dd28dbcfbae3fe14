# SPDX-License-Identifier: Apache-2.0
"""An evaluation as a Parquet or CSV file, one row per LiDAR of each run."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any, BinaryIO

from multilica.errors import UsageError
from multilica.fleet.evaluation import Evaluation
from multilica.fleet.evaluation_document import comparison_row, evaluation_document
from multilica.sinks.atomic import atomic_file

__all__ = ["TABLE_SUFFIXES", "require_table_name", "write_table"]

TABLE_SUFFIXES = (".parquet", ".csv")
_TEXT_COLUMNS = frozenset({"run", "truth", "target", "lidar", "outcome", "reason"})


def require_table_name(path: Path) -> None:
    """See that the name tells the format.

    Raises:
        UsageError: it does not.
    """
    if path.suffix not in TABLE_SUFFIXES:
        raise UsageError(f"Found the table name {path}; expected one that ends in {' or '.join(TABLE_SUFFIXES)}.")


def write_table(evaluation: Evaluation, path: Path) -> None:
    """Write the rows; the name tells the format, folders above it are made.

    Columns name their unit. A LiDAR that was not placed has nulls (in CSV: nothing) for errors. Parquet carries
    tolerances, summaries and what was left out as JSON in its metadata, under the key `multilica`.

    Raises:
        UsageError: the name tells no known format.
    """
    require_table_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        (_write_parquet if path.suffix == ".parquet" else _write_csv)(evaluation, file)


def _write_csv(evaluation: Evaluation, file: BinaryIO) -> None:
    rows = [comparison_row(comparison) for comparison in evaluation.comparisons]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    file.write(text.getvalue().encode("utf-8"))


def _write_parquet(evaluation: Evaluation, file: BinaryIO) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    rows = [comparison_row(comparison) for comparison in evaluation.comparisons]
    document = evaluation_document(evaluation)
    del document["lidars"]
    types = {name: _column_type(pa, name) for name in rows[0]}
    schema = pa.schema(types, metadata={"multilica": json.dumps(document, ensure_ascii=False)})
    parquet.write_table(pa.Table.from_pylist(rows, schema=schema), file)


def _column_type(pa: Any, name: str) -> Any:  # noqa: ANN401
    if name in _TEXT_COLUMNS:
        return pa.string()
    return pa.bool_() if name == "placed" else pa.float64()
