# SPDX-License-Identifier: Apache-2.0
"""`multilica view`: a run to look at."""

from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import Quiet
from multilica_cli.terminal import stdout_console

__all__ = ["view"]


def view(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="A run directory or a recording (.rrd), also one that was cut off.", show_default=False
        ),
    ],
    *,
    png: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw a picture instead of opening a window; needs no screen.")
    ] = None,
    width_px: Annotated[int, typer.Option("--width", metavar="PX", help="Width of the picture.")] = 1600,
    height_px: Annotated[int, typer.Option("--height", metavar="PX", help="Height of the picture.")] = 900,
    quiet: Quiet = False,
) -> None:
    """Open the recording of a run in Rerun's viewer, or draw it into a file."""
    from multilica.runs.run_picture import picture_of_run, recording_of_run
    from multilica.sinks.files.atomic import atomic_file
    from multilica.sinks.rerun.viewer import show_recording

    if png is None:
        show_recording(recording_of_run(run))
        return
    picture = picture_of_run(run, (width_px, height_px))
    with atomic_file(png) as file:
        file.write(picture)
    stdout_console(quiet=quiet).print(f"wrote {png}")
