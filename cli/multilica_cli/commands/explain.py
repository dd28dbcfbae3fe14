# SPDX-License-Identifier: Apache-2.0
"""`multilica explain`: what came of a run, and why."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Json
from multilica_cli.terminal import stdout_console

__all__ = ["explain"]


def explain(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="A run directory, its result.json, a recording (.rrd), also one cut off, or its result.mcap.",
            show_default=False,
        ),
    ],
    *,
    as_json: Json = False,
) -> None:
    """Tell what a run placed and how sure, what it did not place, why, and what would help."""
    from multilica.fleet.explain_run import explain_run

    explanation = explain_run(run)
    if as_json:
        typer.echo(json.dumps(asdict(explanation), indent=2, ensure_ascii=False, allow_nan=False))
        return
    console = stdout_console()
    for line in explanation.lines:
        console.print(line)
