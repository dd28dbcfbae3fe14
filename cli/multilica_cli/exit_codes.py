# SPDX-License-Identifier: Apache-2.0
"""Ends of the process: exit codes and failures."""

from __future__ import annotations

import errno
import os
import sys
from enum import IntEnum
from shutil import get_terminal_size
from typing import TYPE_CHECKING

import typer

from multilica.errors import InputError, MultilicaError, UsageError
from multilica_cli.signals import PREFIX, Interrupted, print_line
from multilica_cli.terminal import printable, without_commands, wrapped

if TYPE_CHECKING:
    from multilica.run import CalibrationRun

DEBUG_VARIABLE = "MULTILICA_DEBUG"
"""Environment variable; 1 adds the traceback to each failure."""
_LONGEST = 500
_OWN = ("multilica", "multilica_cli")
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


class ExitCode(IntEnum):
    """Exit code of the process; a signal ends it with 128 + its number."""

    DONE = 0
    BROKEN = 1
    USAGE = 2
    INPUT = 3
    NOT_PLACED = 4
    DIFFERENT = 5


def exit_code(run: CalibrationRun) -> ExitCode:
    """Return DONE if every LiDAR, and the ground if asked for, has a certain pose, or if the run was to stop before.

    A LiDAR of a running vehicle that sent nothing has none.
    """
    from multilica.config import STAGES

    stopped_early = STAGES.index(run.config.until) < STAGES.index("merge")
    doubt = run.result.ground_refusal or (run.result.ground is not None and run.result.ground.doubt)
    complete = run.result.status == "complete" and not doubt and not run.silent
    return ExitCode.DONE if stopped_early or complete else ExitCode.NOT_PLACED


def print_failure(failure: BaseException) -> int:
    """Print the failure on stderr and return the exit code."""
    code, sentence = describe_failure(failure)
    if sentence:
        line = without_commands(printable(" ".join(sentence.split())))
        if len(line) > _LONGEST:  # by a name or a text of the input
            line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
        print_line(wrapped(line, get_terminal_size().columns - len(PREFIX)) if sys.stderr.isatty() else line)
    if os.environ.get(DEBUG_VARIABLE) == "1":
        sys.excepthook(type(failure), failure, failure.__traceback__)
    return code


def describe_failure(failure: BaseException) -> tuple[int, str]:  # noqa: C901, PLR0911 - a return per kind of failure
    """Return the exit code of a failure, and a sentence for the user that is empty if there is nothing to say."""
    match failure:
        case UsageError():
            return ExitCode.USAGE, str(failure)
        case InputError():
            return ExitCode.INPUT, _with_notes(failure)
        case MultilicaError():
            return ExitCode.BROKEN, _with_notes(failure)
        case Interrupted():
            return failure.exit_code, _with_notes(failure)
        case typer.TyperException():
            message = str(getattr(failure, "format_message", failure.__str__)()).strip().rstrip(".")
            # It is empty after typer printed the help itself.
            return ExitCode.USAGE, message and f"{message}; see `multilica --help` and `multilica COMMAND --help`."
        case BrokenPipeError():
            return ExitCode.BROKEN, ""
        case ImportError() if "failed to map segment" in str(failure) or "llocate memory" in str(failure):
            return ExitCode.BROKEN, (
                f"Out of memory: a library cannot be loaded ({failure}); allow the process more memory (`ulimit -v`)."
            )
        case ImportError() if "shared object" in str(failure):
            return ExitCode.BROKEN, (
                f"A library that multilica needs cannot be loaded ({failure}); `multilica doctor` names the command "
                "that repairs it."
            )
        case ModuleNotFoundError(name=str(name)) if name.partition(".")[0] not in _OWN:
            return ExitCode.BROKEN, (
                f"A library that multilica needs is not installed ({name}); `pip install --force-reinstall multilica` "
                "installs all of them."
            )
        case OSError():
            where = f" ({failure.filename})" if failure.filename else ""
            remedy = "; free some space, or write elsewhere" if failure.errno in _NO_SPACE else ""
            return ExitCode.BROKEN, f"System error: {failure.strerror or failure}{where}{remedy}."
        case MemoryError():
            return ExitCode.BROKEN, "Out of memory; use fewer --frames or a larger preprocess.voxel_size_m."
        case _:
            return ExitCode.BROKEN, (
                f"This is a bug in multilica, not in the input ({type(failure).__name__}: {failure}); "
                f"please report it with the traceback that {DEBUG_VARIABLE}=1 prints."
            )


def _with_notes(failure: BaseException) -> str:
    return " ".join((str(failure), *getattr(failure, "__notes__", ())))
