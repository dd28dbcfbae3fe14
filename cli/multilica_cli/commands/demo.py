# SPDX-License-Identifier: Apache-2.0
"""`multilica demo`: calibration of the embedded sample."""

from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Quiet
from multilica_cli.outcome import exit_code, print_run

__all__ = ["demo"]


def demo(
    *,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Directory for the results.")] = Path("recordings/runs/demo"),
    quiet: Quiet = False,
) -> int:
    """Calibrate the embedded sample and compare the result with the ground truth."""
    from multilica.config import preset
    from multilica.extrinsics import read_extrinsics
    from multilica.run import run_calibration
    from multilica_cli.progress import show_progress
    from multilica_cli.sample import find_sample

    sample = find_sample()
    with show_progress(quiet=quiet) as observe:
        run = run_calibration(sample.recording, out, preset("default"), observe=observe)
    print_run(run, read_extrinsics(sample.truth), quiet=quiet)
    return exit_code(run)
