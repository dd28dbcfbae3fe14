# SPDX-License-Identifier: Apache-2.0
"""`multilica explain`: explanation of a run's outcome."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Json
from multilica_cli.terminal import print_json, stdout_console

__all__ = ["explain"]


def explain(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="Run directory, its result.json, its result.mcap, or a recording (.rrd), complete or not.",
            show_default=False,
        ),
    ],
    *,
    as_json: Json = False,
) -> None:
    """Explain a run: which LiDARs are placed and how accurately, which are not and why, and what would help."""
    from multilica.runs.explain_run import explain_run

    explanation = explain_run(run)
    if as_json:
        print_json(asdict(explanation))
        return
    console = stdout_console()
    for line in explanation.lines:
        console.print(line)
