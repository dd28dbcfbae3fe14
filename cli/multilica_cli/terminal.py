# SPDX-License-Identifier: Apache-2.0
"""Consoles for text on stdout or stderr."""

import json
from typing import Any

import typer
from rich.console import Console
from rich.text import Text

from multilica.errors import escape_controls

__all__ = ["print_json", "printable", "stderr_console", "stdout_console"]

_WIDTH_OF_FILES = 160
_LEAST_WIDTH = 100


class _PlainConsole(Console):
    """A rich console that prints control characters as escapes, also in cells of tables."""

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


def stdout_console(*, quiet: bool = False) -> Console:
    """Return a console for results that is at least 100 columns wide, so that tables keep their digits."""
    console = _console(stderr=False, quiet=quiet)
    console.width = max(console.width, _LEAST_WIDTH)
    return console


def stderr_console(*, quiet: bool = False) -> Console:
    """Return a console for progress."""
    return _console(stderr=True, quiet=quiet)


def _console(*, stderr: bool, quiet: bool) -> Console:
    console = _PlainConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False, emoji=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES  # tables in logs must not depend on a terminal
    return console
