# SPDX-License-Identifier: Apache-2.0
"""`multilica diff`: two runs held against each other."""

from math import radians
from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.failures import ExitCode
from multilica_cli.options import Json
from multilica_cli.terminal import stdout_console

__all__ = ["diff"]

_RUN_HELP = "A run directory, its result.json, or a recording (.rrd)."


def diff(
    run_a: Annotated[Path, typer.Argument(metavar="RUN_A", help=_RUN_HELP, show_default=False)],
    run_b: Annotated[Path, typer.Argument(metavar="RUN_B", help=_RUN_HELP, show_default=False)],
    *,
    within_m: Annotated[
        float, typer.Option(metavar="M", min=0.0, help="A LiDAR that moved by no more stands where it stood.")
    ] = 1e-4,
    within_deg: Annotated[float, typer.Option(metavar="DEG", min=0.0, help="The same for the angle.")] = 1e-3,
    as_json: Json = False,
) -> int:
    """Tell which extrinsics moved between two runs, which LiDARs changed status, and where the runs part.

    Ends with 0 if both place the same LiDARs at the same places, with 5 if not.
    """
    from multilica.runs.difference import compare_runs
    from multilica.runs.difference_document import difference_document
    from multilica.runs.run_documents import read_run_document
    from multilica_cli.tables.difference import print_difference

    before, after = read_run_document(run_a), read_run_document(run_b)
    difference = compare_runs(before, after, within_m=within_m, within_rad=radians(within_deg))
    if as_json:
        typer.echo(difference_document(difference).model_dump_json(indent=2))
    else:
        print_difference(difference, stdout_console())
    return ExitCode.DONE if difference.same else ExitCode.DIFFERENT
