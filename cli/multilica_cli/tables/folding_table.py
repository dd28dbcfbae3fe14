# SPDX-License-Identifier: Apache-2.0
"""Tables that keep their digits in a narrow terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table

_NARROWEST = 8


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
            fits = _width(self._table(wider, 0, limits), console) <= width
            if fits or blocks[-1] == keys:
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
        wanted = [min(self._width_of(each), max(third, self._longest_word(each))) for each in every]
        keys, others = wanted[: self._keys], wanted[self._keys :]
        room = width - 1 - (min(third, max(others, default=0)) + 1)
        if sum(keys) + len(keys) > room:
            widest = keys.index(max(keys))
            keys = [min(each, third) for each in keys]
            keys[widest] = 0
            keys[widest] = min(wanted[widest], max(_NARROWEST, room - sum(keys) - len(keys)))
        beside = max(_NARROWEST, width - 2 - sum(keys) - len(keys))
        return [*keys, *(min(each, beside) for each in others)]

    def _longest_word(self, column: int) -> int:
        return max((cell_len(word) for cell in self._cells_of(column) for word in cell.split()), default=0)

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
