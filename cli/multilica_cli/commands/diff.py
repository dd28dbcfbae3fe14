# SPDX-License-Identifier: Apache-2.0
"""`multilica diff`: two runs held against each other."""

from __future__ import annotations

import json
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from multilica.errors import UsageError
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
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Recording to write: both rigs laid over each other.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Tell which extrinsics moved between two runs, which LiDARs changed status, and where the runs part.

    Ends with 0 if both place the same LiDARs at the same places, with 5 if not.
    """
    from multilica.fleet.difference import compare_runs
    from multilica.fleet.difference_document import difference_document
    from multilica.fleet.run_documents import read_run_document
    from multilica_cli.difference_tables import print_difference

    if recording is not None and recording.suffix != ".rrd":
        raise UsageError(f"Found --recording {recording}; expected a name that ends in .rrd.")
    before, after = read_run_document(run_a), read_run_document(run_b)
    difference = compare_runs(before, after, within_m=within_m, within_rad=radians(within_deg))
    if recording is not None:
        from multilica.fleet.difference_recording import write_difference_recording

        write_difference_recording(recording, before, after, difference)
    if as_json:
        typer.echo(json.dumps(difference_document(difference), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        console = stdout_console()
        print_difference(difference, console)
        if recording is not None:
            console.print(f"wrote {recording}")
    return ExitCode.DONE if difference.same else ExitCode.DIFFERENT
