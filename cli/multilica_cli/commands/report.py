# SPDX-License-Identifier: Apache-2.0
"""`multilica report`: the page of a run that did not come to write it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from multilica.errors import UsageError
from multilica_cli.options import Quiet
from multilica_cli.terminal import stdout_console

__all__ = ["report"]


def report(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="A run directory or a recording (.rrd), also one that was cut off.", show_default=False
        ),
    ],
    *,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The page to write.", show_default="RUN/report.html")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make report.html from what a run left; `calibrate` writes a fuller one itself, unless it is killed."""
    from multilica.fleet.run_report import report_of_run
    from multilica.sinks.atomic import write_text_atomically
    from multilica.sinks.report.report_file import REPORT_HTML

    file = out or (run if run.is_dir() else run.parent) / REPORT_HTML
    if out is None and file.exists():
        raise UsageError(f"{file} is there, and may show more than one made anew; give --out FILE for another.")
    write_text_atomically(file, report_of_run(run))
    stdout_console(quiet=quiet).print(f"wrote {file}")
