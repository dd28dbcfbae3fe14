# SPDX-License-Identifier: Apache-2.0
"""`multilica evaluate`: comparison of runs with ground truth."""

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
        typer.Argument(metavar="RUN", help="Run directory or its result.json; one or more.", show_default=False),
    ],
    *,
    truths: Annotated[
        list[Path],
        typer.Option(
            "--truth",
            metavar="FILE",
            help="Ground truth as `simulate` writes it: one file for all runs, or repeated, one per run in order.",
            show_default=False,
        ),
    ],
    within_m: Annotated[float, typer.Option(metavar="M", help="Largest position error of a success.")] = 0.02,
    within_deg: Annotated[float, typer.Option(metavar="DEG", help="Largest rotation error of a success.")] = 0.1,
    wrong_m: Annotated[
        float, typer.Option(metavar="M", help="Position error above which it is a false accept.")
    ] = 0.05,
    wrong_deg: Annotated[
        float, typer.Option(metavar="DEG", help="Rotation error above which it is a false accept.")
    ] = 0.5,
    wrong_sigma: Annotated[
        float, typer.Option(metavar="N", help="Sigmas above which an error is a false accept.")
    ] = 4.0,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a .parquet or .csv table with a row per LiDAR.")
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare runs with ground truth: RMSE per axis, success rate, false accepts and false refusals."""
    from multilica import runs as saved
    from multilica.extrinsics import read_extrinsics
    from multilica.runs.evaluation_document import evaluation_document
    from multilica.runs.tables import require_table_name, write_table
    from multilica_cli.tables.evaluation import print_evaluation

    if out is not None:
        require_table_name(out)
    tolerances = saved.Tolerances(within_m, radians(within_deg), wrong_m, radians(wrong_deg), wrong_sigma)
    known = [saved.Truth(str(path), read_extrinsics(path)) for path in truths]
    evaluation = saved.evaluate([saved.read_run(path) for path in runs], known, tolerances)
    if out is not None:
        write_table(evaluation, out)
    if as_json:
        typer.echo(evaluation_document(evaluation).model_dump_json(indent=2))
        return
    console = stdout_console(quiet=quiet)
    print_evaluation(evaluation, console)
    if out is not None:
        console.print(f"wrote {out}")
