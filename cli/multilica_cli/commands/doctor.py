# SPDX-License-Identifier: Apache-2.0
"""`multilica doctor`: state of the installation."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import Json
from multilica_cli.terminal import print_json, stdout_console

if TYPE_CHECKING:
    from multilica.installation import Installation, Library

_WIDTH = 80
_NAME, _VERSION = 17, 12
_NO_BREAK = "\N{NO-BREAK SPACE}"


def doctor(*, as_json: Json = False) -> int:
    """Check the installation: libraries, viewer, disk, and the commands that repair missing parts.

    Exits with 0 if the core works, with 1 if a required part is missing or broken.
    """
    from multilica.installation import examine_installation

    found = examine_installation()
    if as_json:
        print_json({"works": found.works, "commands": found.commands, **asdict(found)})
    else:
        console = stdout_console()
        for line in _lines(found):
            console.print(line)
    return ExitCode.DONE if found.works else ExitCode.BROKEN


def _lines(found: Installation) -> Iterator[str]:
    yield f"multilica {found.multilica}, Python {found.python}"
    yield from _wrapped(found.platform)
    unfit = [library for library in found.core if library.state != "works"]
    yield ""
    yield f"Core: {len(found.core) - len(unfit)} of {len(found.core)} libraries work"
    yield from _wrapped(", ".join(f"{each.name}{_NO_BREAK}{each.version}" for each in found.core if each.version))
    for library in unfit:
        yield from _row(library)
    yield ""
    yield "Optional libraries"
    for library in found.optional:
        yield from _row(library)
    yield ""
    yield "Viewer"
    yield from _fact("window", "can be opened" if found.viewer.screen else "none: there is no screen")
    yield from _fact("pictures", _pictures(found))
    yield ""
    yield "Machine"
    yield from _fact("cores", str(found.machine.cores))
    threads = ", ".join(f"{name}={value}" for name, value in found.machine.threads.items())
    yield from _fact("threads", threads or "no limit is set")
    for folder, free in found.machine.free_bytes.items():
        yield from _fact("free disk", f"{free / 1e9:.1f} GB in {folder}")
    yield ""
    yield "The core works." if found.works else "A part of the core is missing or broken."
    if found.commands:
        yield "To install or repair the other parts:"
        yield from (f"  {command}" for command in found.commands)


def _row(library: Library) -> Iterator[str]:
    """Yield a library with its state, what it is for, and what is wrong with it."""
    state = library.version if library.state == "works" else library.state
    yield from _wrapped(f"{library.name:{_NAME}}{state:{_VERSION}}{library.purpose}".rstrip(), _NAME + _VERSION)
    yield from _wrapped(library.problem, _NAME) if library.problem else ()


def _pictures(found: Installation) -> str:
    drivers = ", ".join(found.viewer.drivers)
    if found.viewer.renderer == "none":
        return f"none: view --png lacks a library; Vulkan drivers: {drivers or 'none'}"
    return f"drawn by {'the GPU' if found.viewer.renderer == 'GPU' else 'software'} (Vulkan drivers: {drivers})"


def _fact(name: str, text: str) -> Iterator[str]:
    yield from _wrapped(f"{name:{_NAME}}{text}", _NAME)


def _wrapped(text: str, indent: int = 0) -> list[str]:
    """Wrap a text within the width, except at no-break spaces; later lines are indented further."""
    later = " " * (indent + 2)
    lines = textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent=later, break_on_hyphens=False)
    return [line.replace(_NO_BREAK, " ") for line in lines]
