# SPDX-License-Identifier: Apache-2.0
"""Where text for people goes."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["printable", "stderr_console", "stdout_console"]

_WIDTH_OF_FILES = 160
_LEAST_WIDTH = 100
_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\n\t"}


def printable(text: str) -> str:
    """The text with control characters as escapes: a recording's topics and frames may hold what steers a terminal."""
    return text.translate(_ESCAPES).encode("utf-8", "backslashreplace").decode("utf-8")


def stdout_console(*, quiet: bool = False) -> Console:
    """For results; says nothing when `quiet`. On a narrow terminal tables break rather than lose digits."""
    console = _console(stderr=False, quiet=quiet)
    console.width = max(console.width, _LEAST_WIDTH)
    return console


def stderr_console(*, quiet: bool = False) -> Console:
    """For progress; says nothing when `quiet`."""
    return _console(stderr=True, quiet=quiet)


def _console(*, stderr: bool, quiet: bool) -> Console:
    """Plain text of a fixed width where nobody watches: tables in logs must not depend on a terminal."""
    from multilica_cli.plain_console import PlainConsole

    console = PlainConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False, emoji=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES
    return console
