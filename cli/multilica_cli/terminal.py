# SPDX-License-Identifier: Apache-2.0
"""Consoles for text on stdout or stderr."""

import json
import textwrap
from functools import partial
from typing import Any

import typer
from rich.console import Console
from rich.text import Text

from multilica.errors import escape_controls

_WIDTH_OF_FILES = 160


class _PlainConsole(Console):
    """A rich console that prints control characters as escapes, also in cells of tables, and breaks no word."""

    def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401 - those of rich
        """Print; a terminal's lines end between words, those of a file where the text does."""
        if self.is_terminal:
            objects = tuple(wrapped(each, self.width) if isinstance(each, str) else each for each in objects)
        super().print(*objects, **options)

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401 - those of rich
        """Render text that has no style yet."""
        return super().render_str(printable(text), **options)


def printable(text: str) -> str:
    """Escape control characters: names from a recording could otherwise send commands to the terminal."""
    lines = ("\t".join(map(escape_controls, line.split("\t"))) for line in text.split("\n"))
    return "\n".join(lines).encode("utf-8", "backslashreplace").decode("utf-8")


def print_json(document: object) -> None:
    """Print a document of plain values as JSON on stdout."""
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def wrapped(text: str, width: int) -> str:
    """Break the lines of a text between words; what follows the first line of one that is too long is indented."""
    return "\n".join(_wrapped_line(line, width) for line in text.split("\n"))


def _wrapped_line(line: str, width: int) -> str:
    indent = line[: len(line) - len(line.lstrip())]
    parts = textwrap.wrap(
        line,
        max(width, 20),
        subsequent_indent=f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
        drop_whitespace=True,
    )
    return "\n".join(parts) if len(line) > width else line


def _console(*, stderr: bool, quiet: bool = False) -> Console:
    console = _PlainConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False, emoji=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES  # tables in logs must not depend on a terminal
    return console


stdout_console = partial(_console, stderr=False)
"""Create a console for results."""
stderr_console = partial(_console, stderr=True)
"""Create a console for progress."""
