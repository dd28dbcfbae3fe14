# SPDX-License-Identifier: Apache-2.0
"""`multilica demo`: the main job on the recording that comes with multilica."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Quiet
from multilica_cli.outcome import print_explanation, print_placements, print_written
from multilica_cli.run import calibrate_sources, exit_code_of
from multilica_cli.terminal import stdout_console

__all__ = ["demo"]


def demo(
    *,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where results go.")] = Path("recordings/runs/demo"),
    quiet: Quiet = False,
) -> int:
    """Calibrate the embedded sample, and show what was found beside the truth."""
    from multilica.config import preset
    from multilica.extrinsics import read_extrinsics
    from multilica_cli.sample import find_sample
    from multilica_cli.tables import truth_table

    sample = find_sample()
    config = preset("default")
    run = calibrate_sources([sample.recording], out, config, quiet=quiet)
    console = stdout_console(quiet=quiet)
    print_placements(run, console)
    console.print(truth_table(run.result, read_extrinsics(sample.truth)))
    print_written(run, console)
    print_explanation(run, console)
    return exit_code_of(run.result, config)
