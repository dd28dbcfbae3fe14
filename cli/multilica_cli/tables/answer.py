# SPDX-License-Identifier: Apache-2.0
"""Answers of a fleet's store on the terminal."""

from __future__ import annotations

import csv
import io
import json
from datetime import datetime
from typing import TYPE_CHECKING, Literal

import typer
from rich.console import Console

from multilica_cli.tables.result import plain_table

if TYPE_CHECKING:
    from multilica.fleet.store.query import QueryAnswer

__all__ = ["print_answer"]

_MOST_ROWS = 1000


def print_answer(answer: QueryAnswer, form: Literal["table", "csv", "json"], console: Console) -> None:
    """Print the rows: as a table for people, which ends after a thousand, or all as CSV or as JSON, a row per line."""
    if form == "csv":
        typer.echo(_csv_line(answer.columns), nl=False)
        for row in answer.rows():
            typer.echo(_csv_line([_plain(value) for value in row]), nl=False)
        return
    if form == "json":
        for row in answer.rows():
            named = {name: _plain(value) for name, value in zip(answer.columns, row, strict=True)}
            typer.echo(json.dumps(named, ensure_ascii=False, allow_nan=False))
        return
    table = plain_table("", [name.replace("_", " ") for name in answer.columns], numbers_from=len(answer.columns))
    count = 0
    for row in answer.rows():
        count += 1
        if count <= _MOST_ROWS:
            table.add_row(*map(_cell, row))
    console.print(table)
    if count > _MOST_ROWS:
        console.print(f"{count - _MOST_ROWS} more rows; --format csv prints all.")


def _plain(value: object) -> object:
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
            return f"{value:.4g}"
        case _:
            return str(value)
