# SPDX-License-Identifier: Apache-2.0
"""Tables on the terminal: for people, as CSV, or as JSON."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Literal

import typer
from rich.console import Console

from multilica_cli.tables.folding_table import FoldingTable

if TYPE_CHECKING:
    from multilica.fleet.store.query import QueryAnswer

_MOST_ROWS = 1000


def print_answer(
    answer: QueryAnswer, form: Literal["table", "csv", "json"], console: Console, *, keys: int = 1
) -> None:
    """Print the rows: as a table for people, which ends after a thousand, or all as CSV or as JSON, a row per line.

    Args:
        keys: number of leading columns that name a row.
    """
    if form != "table":
        for line in answer_lines(answer.columns, answer.rows(), form):
            typer.echo(line, nl=False)
        return
    columns = [name.replace("_", " ") for name in answer.columns]
    table = FoldingTable("", columns, numbers_from=len(columns), keys=min(keys, len(columns)))
    count = 0
    for row in answer.rows():
        count += 1
        if count <= _MOST_ROWS:
            table.add_row(*map(_cell, row))
    console.print(table)
    if count > _MOST_ROWS:
        console.print(f"{count - _MOST_ROWS} more rows; --format csv prints all.")


def answer_lines(
    columns: Sequence[str], rows: Iterable[Sequence[object]], form: Literal["csv", "json"]
) -> Iterator[str]:
    """Yield the lines of a table: CSV with a header, or a JSON object per row; what is unknown is empty or null."""
    if form == "csv":
        yield _csv_line(columns)
    for row in rows:
        values = [_plain(value) for value in row]
        if form == "csv":
            yield _csv_line(values)
        else:
            named = dict(zip(columns, values, strict=True))
            yield json.dumps(named, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.isoformat() if isinstance(value, datetime) else value


def _csv_line(values: object) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(values)  # type: ignore[arg-type]
    return line.getvalue()


def _cell(value: object) -> str:
    match value:
        case None:
            return "-"
        case datetime():
            return value.strftime("%Y-%m-%d %H:%M")
        case float():
            return f"{value:z.4g}"
        case _:
            return str(value)
