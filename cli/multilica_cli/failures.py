# SPDX-License-Identifier: Apache-2.0
"""How each failure is told: one sentence, one exit code."""

from __future__ import annotations

import os
import sys
from enum import IntEnum

import typer

from multilica.errors import InputError, MultilicaError, UsageError
from multilica_cli.interruption import Interrupted
from multilica_cli.terminal import printable

__all__ = ["DEBUG_VARIABLE", "ExitCode", "explain", "report"]

DEBUG_VARIABLE = "MULTILICA_DEBUG"
"""Environment variable; set to 1, failures come with their traceback."""


class ExitCode(IntEnum):
    """What the process ends with; a signal ends it with 128 + its number."""

    DONE = 0
    BROKEN = 1
    USAGE = 2
    INPUT = 3
    NOT_PLACED = 4
    DIFFERENT = 5


def report(failure: BaseException) -> int:
    """Tell the failure on stderr; returns the exit code."""
    code, sentence = explain(failure)
    if sentence:
        print(f"multilica: {_one_line(sentence)}", file=sys.stderr)  # noqa: T201
    if os.environ.get(DEBUG_VARIABLE) == "1":
        sys.excepthook(type(failure), failure, failure.__traceback__)
    return code


def explain(failure: BaseException) -> tuple[int, str]:
    """The exit code of a failure, with the sentence that tells it."""
    match failure:
        case UsageError():
            return ExitCode.USAGE, str(failure)
        case InputError():
            return ExitCode.INPUT, _with_notes(failure)
        case MultilicaError():
            return ExitCode.BROKEN, str(failure)
        case Interrupted():
            return failure.exit_code, _with_notes(failure)
        case typer.TyperException():
            return ExitCode.USAGE, _usage_sentence(failure)
        case _:
            return ExitCode.BROKEN, _machine_or_bug(failure)


def _machine_or_bug(failure: BaseException) -> str:
    match failure:
        case BrokenPipeError():
            return ""
        case ImportError() if "shared object" in str(failure):
            return (
                f"A library that multilica needs cannot be loaded ({failure}); on Debian and Ubuntu "
                "`sudo apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1` installs what Open3D needs."
            )
        case OSError():
            where = f" ({failure.filename})" if failure.filename else ""
            return f"The operating system refused: {failure.strerror or failure}{where}."
        case MemoryError():
            return "Memory is exhausted; fewer --frames or a larger preprocess.voxel_size_m need less."
        case _:
            return (
                f"This is a bug in multilica, not in the input ({type(failure).__name__}: {failure}); "
                f"please report it with what {DEBUG_VARIABLE}=1 adds to this message."
            )


def _usage_sentence(failure: typer.TyperException) -> str:
    """What typer objects to, which its errors know better than their text; "" after it printed the help itself."""
    message = str(getattr(failure, "format_message", failure.__str__)()).strip().rstrip(".")
    return f"{message}; see `multilica --help` and `multilica COMMAND --help`." if message else ""


def _with_notes(failure: BaseException) -> str:
    return " ".join((str(failure), *getattr(failure, "__notes__", ())))


def _one_line(text: str) -> str:
    return printable(" ".join(text.split()))
