# SPDX-License-Identifier: Apache-2.0
"""Consoles for text on stdout or stderr, tables on them, and rows of tables as CSV or JSON."""

from __future__ import annotations

import csv
import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import typer
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from multilica.errors import escape_controls

if TYPE_CHECKING:
    from multilica.fleet.store.query import QueryAnswer
    from multilica.geometry import RigidTransform
    from multilica.results.document import LidarEntry

_WIDTH_OF_FILES = 160
POSE_COLUMNS = ("x\nm", "y\nm", "z\nm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg")
ERROR_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "total\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "total\ndeg")
_NARROWEST = 8
_MOST_ROWS = 1000
_COMMAND = re.compile(r"^([^\S\n]*):(?=:)|#(?=#\w*\[)", re.MULTILINE)
"""First character of a command in a line, as GitHub Actions, Azure Pipelines and TeamCity read them."""


class _PlainConsole(Console):
    """A rich console that prints control characters as escapes, also in cells of tables, and breaks no word.

    It prints no command to a CI service either.
    """

    def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401 - those of rich
        """Print; a terminal's lines end between words, those of a file where the text does."""
        if self.is_terminal:
            objects = tuple(wrapped(each, self.width) if isinstance(each, str) else each for each in objects)
        super().print(*objects, **options)

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401 - those of rich
        """Render text that has no style yet."""
        return super().render_str(printable(text), **options)

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        """Return the lines as they are written."""
        return without_commands(super()._render_buffer(buffer))


def printable(text: str) -> str:
    """Escape control characters: names from a recording could otherwise send commands to the terminal."""
    lines = ("\t".join(map(escape_controls, line.split("\t"))) for line in text.split("\n"))
    return "\n".join(lines).encode("utf-8", "backslashreplace").decode("utf-8")


def without_commands(text: str) -> str:
    """Escape commands to CI services: a name from a recording could otherwise begin one, such as ``::error::``."""
    return _COMMAND.sub(lambda found: f"{found[1] or ''}\\x{ord(found[0][-1]):02x}", text)


def print_json(document: object) -> None:
    """Print a document of plain values as JSON on stdout."""
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def wrapped(text: str, width: int) -> str:
    """Break the lines of a text between words; what follows the first line of one that is too long is indented."""
    lines = []
    for line in text.split("\n"):
        wrapper = textwrap.TextWrapper(
            max(width, 20), break_long_words=False, break_on_hyphens=False, replace_whitespace=False
        )
        wrapper.subsequent_indent = f"{line[: len(line) - len(line.lstrip())]}  "
        lines.append("\n".join(wrapper.wrap(line)) if len(line) > width else line)
    return "\n".join(lines)


def _console(*, stderr: bool, quiet: bool = False) -> Console:
    console = _PlainConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False, emoji=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES  # tables in logs must not depend on a terminal
    return console


stdout_console = partial(_console, stderr=False)
"""Create a console for results."""
stderr_console = partial(_console, stderr=True)
"""Create a console for progress."""


class FoldingTable:
    """A table without colours that fits the width of the console.

    A table that is too wide loses the spare gaps first, then the columns that are not needed. If that is not enough,
    the columns continue in a further table below, which repeats the key columns. Texts wrap between words; a word is
    broken only if it leaves no room for one column beside the keys.

    Args:
        columns: headings.
        numbers_from: columns from this one on hold numbers.
        keys: number of leading columns that name a row.
        spare: headings of columns that a narrow table leaves out.
    """

    def __init__(
        self, title: str, columns: Iterable[str], *, numbers_from: int = 1, keys: int = 1, spare: Sequence[str] = ()
    ) -> None:
        self.title = title
        self._columns = tuple(columns)
        self._numbers_from, self._keys = numbers_from, keys
        self._spare = {self._columns.index(each) for each in spare}
        self._rows: list[tuple[str, ...]] = []
        self._section_ends: set[int] = set()

    def add_row(self, *cells: str, end_section: bool = False) -> None:
        """Add a row; missing cells at its end are empty."""
        self._rows.append((*cells, *("",) * (len(self._columns) - len(cells))))
        if end_section:
            self.add_section()

    def add_section(self) -> None:
        """Draw a line after the last row."""
        self._section_ends.add(len(self._rows) - 1)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table, or the tables that it folds into."""
        every, limits = range(len(self._columns)), self._limits(options.max_width)
        needed = [index for index in every if index not in self._spare]
        for chosen, gap in ((every, 1), (every, 0), (needed, 0)):
            table = self._table(chosen, gap, limits)
            if _width(table, console) <= options.max_width:
                yield table
                return
        for title, block in self._blocks(console, options.max_width, limits):
            yield self._table(block, 0, limits, title)

    def _blocks(self, console: Console, width: int, limits: Sequence[int]) -> list[tuple[str, list[int]]]:
        """Return titles and columns of the tables that fit, each with the key columns."""
        keys = list(range(self._keys))
        blocks: list[list[int]] = [keys]
        for index in range(self._keys, len(self._columns)):
            wider = [*blocks[-1], index]
            if blocks[-1] == keys or _width(self._table(wider, 0, limits), console) <= width:
                blocks[-1] = wider
            else:
                blocks.append([*keys, index])
        return [(self.title if number == 0 else "", block) for number, block in enumerate(blocks)]

    def _table(self, columns: Sequence[int], gap: int, limits: Sequence[int], title: str | None = None) -> Table:
        table = Table(
            title=self.title if title is None else title,
            title_justify="left",
            title_style="bold",
            box=box.SIMPLE_HEAD,
            header_style="bold",
            pad_edge=False,
            padding=(0, gap, 0, 0),
        )
        for index in columns:
            is_text = index < self._numbers_from
            wide = is_text and self._width_of(index) > limits[index]
            table.add_column(
                self._columns[index],
                justify="left" if is_text else "right",
                no_wrap=not wide,
                overflow="fold",
                max_width=limits[index] if wide else None,
            )
        for number, row in enumerate(self._rows):
            table.add_row(*(row[index] for index in columns), end_section=number in self._section_ends)
        return table

    def _limits(self, width: int) -> list[int]:
        """Return how wide each column of text may be: a third, or its longest word if there is room for it."""
        third = width // 3
        every = range(len(self._columns))
        words = [[cell_len(word) for cell in self._cells_of(each) for word in cell.split()] for each in every]
        wanted = [min(self._width_of(each), max(third, *words[each], 0)) for each in every]
        keys, others = wanted[: self._keys], wanted[self._keys :]
        room = width - 1 - (min(third, max(others, default=0)) + 1)
        if sum(keys) + len(keys) > room:
            widest = keys.index(max(keys))
            keys = [min(each, third) for each in keys]
            keys[widest] = 0
            keys[widest] = min(wanted[widest], max(_NARROWEST, room - sum(keys) - len(keys)))
        beside = max(_NARROWEST, width - 2 - sum(keys) - len(keys))
        return [*keys, *(min(each, beside) for each in others)]

    def _width_of(self, column: int) -> int:
        return max(cell_len(line) for cell in self._cells_of(column) for line in cell.split("\n"))

    def _cells_of(self, column: int) -> list[str]:
        return [self._columns[column], *(row[column] for row in self._rows)]


def _width(table: Table, console: Console) -> int:
    # A table on its own is as wide as its cells; the title does not count, it is wrapped.
    title, table.title = table.title, None
    try:
        return Measurement.get(console, console.options.update_width(10_000), table).maximum
    finally:
        table.title = title


def number_cells(values: Iterable[float | None], scale: float, digits: int) -> tuple[str, ...]:
    """Format numbers; "-" for one that is not known."""
    return tuple("-" if value is None else f"{scale * value:z.{digits}f}" for value in values)


def size_cells(length_m: float | None, angle_deg: float | None) -> tuple[str, ...]:
    """Format a distance in mm and an angle in degrees."""
    return number_cells((length_m,), 1000.0, 1) + number_cells((angle_deg,), 1.0, 3)


def pose_cells(pose: RigidTransform | LidarEntry | None) -> tuple[str, ...]:
    """Format a pose for `POSE_COLUMNS`."""
    if pose is None or pose.xyz_m is None or pose.rpy_deg is None:
        return ("-",) * len(POSE_COLUMNS)
    return *number_cells(pose.xyz_m, 1.0, 3), *number_cells(pose.rpy_deg, 1.0, 2)


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
    """Yield the lines of a table: CSV with a header, or a JSON object per row; what is unknown is empty or null.

    CSV quotes all values of a line that would else be a command to a CI service.
    """
    stream = SimpleNamespace(write=str)  # `writerow` returns what this does
    csv_line, quoted_line = (
        csv.writer(stream, lineterminator="\n", quoting=quoting).writerow
        for quoting in (csv.QUOTE_MINIMAL, csv.QUOTE_ALL)
    )
    if form == "csv":
        yield csv_line(columns)
    for row in rows:
        values = [_plain(value) for value in row]
        if form == "csv":
            line = csv_line(values)
            yield quoted_line(values) if _COMMAND.match(line) else line
        else:
            named = dict(zip(columns, values, strict=True))
            yield json.dumps(named, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.isoformat() if isinstance(value, datetime) else value


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
