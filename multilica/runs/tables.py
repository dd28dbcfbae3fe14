# SPDX-License-Identifier: Apache-2.0
"""Evaluation of runs as a Parquet or CSV file, one row per LiDAR of each run."""

import csv
import io
from pathlib import Path
from typing import Any, BinaryIO

from multilica.errors import UsageError
from multilica.runs.evaluation import Evaluation
from multilica.runs.evaluation_document import ComparisonRow, comparison_row, evaluation_document
from multilica.sinks.files.atomic import atomic_file

__all__ = ["TABLE_SUFFIXES", "require_table_name", "write_table"]

TABLE_SUFFIXES = (".parquet", ".csv")
_TEXT_COLUMNS = frozenset({"run", "truth", "target", "lidar", "outcome", "reason"})


def require_table_name(path: Path) -> None:
    """Check that the name ends in a known suffix.

    Raises:
        UsageError: it does not.
    """
    if path.suffix not in TABLE_SUFFIXES:
        raise UsageError(f"Found the table name {path}; expected one that ends in {' or '.join(TABLE_SUFFIXES)}.")


def write_table(evaluation: Evaluation, path: Path) -> None:
    """Write the rows in the format of the suffix; missing folders are created.

    Columns name their unit. Errors of a LiDAR that was not placed are null, in CSV empty. Parquet has the rest of the
    evaluation document as JSON in its metadata, under the key `multilica`.

    Raises:
        UsageError: unknown suffix.
    """
    require_table_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        (_write_parquet if path.suffix == ".parquet" else _write_csv)(evaluation, file)


def _write_csv(evaluation: Evaluation, file: BinaryIO) -> None:
    rows = [comparison_row(comparison).model_dump() for comparison in evaluation.comparisons]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(ComparisonRow.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    file.write(text.getvalue().encode("utf-8"))


def _write_parquet(evaluation: Evaluation, file: BinaryIO) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    document = evaluation_document(evaluation)
    types = {name: _column_type(pa, name) for name in ComparisonRow.model_fields}
    schema = pa.schema(types, metadata={"multilica": document.model_dump_json(exclude={"lidars"})})
    parquet.write_table(pa.Table.from_pylist([row.model_dump() for row in document.lidars], schema=schema), file)


def _column_type(pa: Any, name: str) -> Any:  # noqa: ANN401
    if name in _TEXT_COLUMNS:
        return pa.string()
    return pa.bool_() if name == "placed" else pa.float64()
