# SPDX-License-Identifier: Apache-2.0
"""`multilica evaluate`: runs beside the truth."""

from __future__ import annotations

import json
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Json, Quiet
from multilica_cli.terminal import stdout_console

__all__ = ["evaluate"]


def evaluate(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="A run directory or its result.json; several.", show_default=False),
    ],
    *,
    truths: Annotated[
        list[Path],
        typer.Option(
            "--truth",
            metavar="FILE",
            help="True extrinsics as `simulate` writes them: one for all runs, or repeated, one per run in order.",
            show_default=False,
        ),
    ],
    within_m: Annotated[float, typer.Option(metavar="M", help="A success is off by no more than this.")] = 0.02,
    within_deg: Annotated[float, typer.Option(metavar="DEG", help="The same for the angle.")] = 0.1,
    wrong_m: Annotated[float, typer.Option(metavar="M", help="Placed and off by more is a false accept.")] = 0.05,
    wrong_deg: Annotated[float, typer.Option(metavar="DEG", help="The same for the angle.")] = 0.5,
    wrong_sigma: Annotated[
        float, typer.Option(metavar="N", help="So is one off by more sigma than this, where the run tells its sigma.")
    ] = 4.0,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Table to write: FILE.parquet or FILE.csv, a row per LiDAR.")
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Hold runs against the truth: RMSE per axis, success rate, false accepts and refusals."""
    from multilica import fleet
    from multilica.extrinsics import read_extrinsics
    from multilica.fleet.evaluation_document import evaluation_document
    from multilica.fleet.tables import require_table_name, write_table
    from multilica_cli.evaluation_tables import print_evaluation

    if out is not None:
        require_table_name(out)
    tolerances = fleet.Tolerances(within_m, radians(within_deg), wrong_m, radians(wrong_deg), wrong_sigma)
    known = [fleet.Truth(str(path), read_extrinsics(path)) for path in truths]
    evaluation = fleet.evaluate([fleet.read_run(path) for path in runs], known, tolerances)
    if out is not None:
        write_table(evaluation, out)
    console = stdout_console(quiet=quiet)
    if as_json:
        typer.echo(json.dumps(evaluation_document(evaluation), indent=2, ensure_ascii=False, allow_nan=False))
        return
    print_evaluation(evaluation, console)
    if out is not None:
        console.print(f"wrote {out}")
