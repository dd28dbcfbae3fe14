# SPDX-License-Identifier: Apache-2.0
"""`multilica export`: a run's poses or clouds as a file for other programs."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from multilica.exports import CLOUD_FORMATS, FORMATS
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import Quiet, argument, option
from multilica_cli.terminal import stderr_console, stdout_console


def _listed(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}"


def export(
    run: Annotated[Path, argument("RUN", "Run directory, its result.json or result.mcap, or a recording.")],
    *,
    to: Annotated[
        str,
        option(
            "--to FORMAT",
            f"{_listed(FORMATS)}; for the stitched cloud {_listed(CLOUD_FORMATS)}.",
            show_default=False,
        ),
    ],
    out: Annotated[
        str,
        option(
            "--out FILE",
            "File to write; in an existing URDF or Autoware file, only the poses of the LiDARs change.",
            show_default=False,
        ),
    ],
    base: Annotated[
        str | None,
        option(
            "--base FRAME",
            "Frame of the poses: a LiDAR, a frame of --rig, or, without --rig, the run's base frame or another "
            "name of the target.",
            show_default="the frame of calibrate --rig, else the target",
        ),
    ] = None,
    rig: Annotated[
        Path | None, option("--rig FILE", "Known pose of the target in FRAME: TOML, URDF or any format of --to.")
    ] = None,
    frames: Annotated[
        Literal["names", "ids"],
        option("--frames names|ids", "Call frames by the LiDARs' names, or by the frame ids of the input."),
    ] = "names",
    with_uncertain: Annotated[bool, option("--with-uncertain", "Export uncertain LiDARs too.")] = False,
    quiet: Quiet = False,
) -> int:
    """Write the poses of a run as a file for other programs, or its clouds in one frame.

    Exits with 4 if a LiDAR of the run is not placed.
    """
    from multilica.exports import export_run

    done = export_run(run, out, to, base=base, rig=rig, frames=frames, with_uncertain=with_uncertain)
    stdout_console(quiet=quiet).print(f"wrote {done.path}: {', '.join(done.lidars)} in {done.base}")
    told = stderr_console()
    if done.missing:
        listed = ", ".join(f"{name} ({status.replace('_', ' ')})" for name, status in done.missing.items())
        told.print(f"multilica: Without {listed}.")
    if done.uncertain:
        told.print(f"multilica: With {', '.join(done.uncertain)}, which are uncertain.")
    return ExitCode.DONE if done.complete else ExitCode.NOT_PLACED
