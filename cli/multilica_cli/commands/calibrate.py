# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate`: calibration of a recording."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from multilica_cli.configuration import sigma_limits
from multilica_cli.exit_codes import exit_code
from multilica_cli.options import NEW_RUN_DIRECTORY, Json, Parameters, Quiet, Reading, Sources, Workers, option, output

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics


def calibrate(
    sources: Sources,
    *,
    target: Annotated[
        str | None,
        option(
            "--target NAME",
            "LiDAR whose frame is the frame of the result.",
            show_default="the one with the most overlap",
        ),
    ] = None,
    out: Annotated[
        Path | None, output("--out DIR", "Directory for the results.", show_default=NEW_RUN_DIRECTORY)
    ] = None,
    prior: Annotated[
        str | None,
        option(
            "--prior tf|FILE",
            "Known poses to test in addition: tf (the recording's /tf_static), or a TOML, URDF or other file of poses.",
        ),
    ] = None,
    reading: Reading,
    parameters: Parameters,
    max_sigma: Annotated[
        str | None,
        option(
            "--max-sigma MM,DEG",
            "Largest standard deviations of a placed LiDAR; above one of them it is uncertain.",
            show_default="20,0.2",
        ),
    ] = None,
    until: Annotated[str | None, option("--until STAGE", "Stop after this stage.")] = None,
    workers: Workers = None,
    max_time_s: Annotated[
        float | None,
        option("--max-time S", "Start no search of a pair later than this, then finish with the pairs found."),
    ] = None,
    ground: Annotated[bool, option("--ground", "Also estimate roll, pitch and height above ground.")] = False,
    base: Annotated[
        str | None,
        option(
            "--base FRAME",
            "Name of the base frame on the ground; implies --ground.",
            show_default="the common frame of --rig, else base",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        option(
            "--rig FILE", "x, y and yaw of the target in FRAME: TOML, URDF or any format of export; implies --ground."
        ),
    ] = None,
    record: Annotated[
        Literal["full", "normal", "slim"] | None,
        option("--record full|normal|slim", "Level of detail of recording.rrd.", show_default="normal"),
    ] = None,
    mcap_encoding: Annotated[
        Literal["foxglove", "ros2"], option("--mcap-encoding foxglove|ros2", "Message encoding of result.mcap.")
    ] = "foxglove",
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Calibrate the LiDARs of a recording and write the results into a directory.

    Several recordings of the same LiDARs are several snapshots of one rig: each is calibrated alone, then all jointly.
    """
    from multilica.orchestration import open_calibration_workers

    known = None
    if rig is not None:
        from multilica import read_extrinsics

        known = read_extrinsics(rig)
        base = base or known.target
    given = {
        "target": target,
        "until": until,
        **reading.values,
        **sigma_limits(max_sigma),
        "ground.enabled": ground or base is not None or None,
        "ground.frame": base,
        "runtime.workers": workers,
        "runtime.max_time_s": max_time_s,
        "record.detail": record,
    }
    resolve = partial(parameters.resolve, given)
    with open_calibration_workers(resolve()) as pool:
        # Imported while the workers start.
        from multilica.ingest import frames_recorded
        from multilica.ingest.locate import locate
        from multilica.run import run_calibration
        from multilica_cli.progress import show_progress
        from multilica_cli.tables.result import print_run

        files = [locate(source) for source in sources]
        config = resolve(frames_recorded(files))
        with show_progress(quiet=quiet) as observe:
            poses = _prior(prior)
            run = run_calibration(
                files, out, config, prior=poses, rig=known, mcap_encoding=mcap_encoding, observe=observe, workers=pool
            )
    if as_json:
        typer.echo((run.directory / "result.json").read_text(encoding="utf-8"), nl=False)
    else:
        print_run(run, quiet=quiet)
    return exit_code(run)


def _prior(source: str | None) -> str | Extrinsics | None:
    """Read a prior of a format that is not the library's own to read: it knows tf, TOML and URDF."""
    if source is None or source == "tf" or Path(source).suffix in (".toml", ".urdf", ".xml", ".xacro"):
        return source
    from multilica import read_extrinsics

    return read_extrinsics(source)
