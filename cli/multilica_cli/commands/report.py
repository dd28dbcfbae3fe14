# SPDX-License-Identifier: Apache-2.0
"""`multilica report`: report of a run that ended before it wrote one."""

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
        typer.Argument(metavar="RUN", help="Run directory or recording (.rrd), complete or not.", show_default=False),
    ],
    *,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write.", show_default="RUN/report.html")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Create report.html for a run that was killed before it wrote one."""
    from multilica.runs.run_report import report_of_run
    from multilica.sinks.files.atomic import write_text_atomically
    from multilica.sinks.report.report_file import REPORT_HTML

    file = out or (run if run.is_dir() else run.parent) / REPORT_HTML
    if out is None and file.exists():
        raise UsageError(f"{file} already exists and may show more than a new one; give --out FILE.")
    write_text_atomically(file, report_of_run(run))
    stdout_console(quiet=quiet).print(f"wrote {file}")
