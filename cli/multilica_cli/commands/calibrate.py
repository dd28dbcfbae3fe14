# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate`: calibration of a recording."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from multilica_cli import options
from multilica_cli.configuration import ingest_options, resolve_config, sigma_limits
from multilica_cli.exit_codes import exit_code

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics


def calibrate(
    sources: options.Sources,
    *,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="LiDAR whose frame the result is given in.",
            show_default="the one with the most overlap",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory for the results.",
            show_default="recordings/runs/<source>, or <source>-2, ... if that is taken",
            callback=options.local_path,
        ),
    ] = None,
    prior: options.PriorSource = None,
    topics: options.Topics = None,
    frames: options.Frames = None,
    start: options.Start = None,
    window: options.Window = None,
    window_s: options.WindowSeconds = None,
    strict: options.Strict = False,
    preset: options.Preset = None,
    config_file: options.ConfigFile = None,
    settings: options.Settings = None,
    max_sigma: options.MaxSigma = None,
    until: Annotated[str | None, typer.Option(metavar="STAGE", help="Stop after this stage.")] = None,
    workers: options.Workers = None,
    max_time_s: Annotated[
        float | None,
        typer.Option(
            "--max-time", metavar="S", help="Search no pair later than this; ends with what it has, and says so."
        ),
    ] = None,
    ground: Annotated[
        bool, typer.Option("--ground", help="Also estimate roll, pitch and height above ground.")
    ] = False,
    base: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="Name of the base frame on the ground; implies --ground.",
            show_default="the common frame of --rig, else base",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="x, y and yaw of the target in FRAME: TOML, URDF or any format of export; implies --ground.",
            show_default=False,
        ),
    ] = None,
    record: options.Record = None,
    mcap_encoding: options.McapEncoding = "foxglove",
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Calibrate the LiDARs of a recording and write the results into a directory.

    Several recordings of the same LiDARs are several snapshots of one rig: each is calibrated alone, then all jointly.
    """
    from multilica.orchestration.calibration_workers import open_calibration_workers

    known = None
    if rig is not None:
        from multilica import read_extrinsics

        known = read_extrinsics(rig)
        base = base or known.target
    given = {
        "target": target,
        "until": until,
        **ingest_options(topics, frames, start, window, window_s, strict=strict),
        **sigma_limits(max_sigma),
        "ground.enabled": ground or base is not None or None,
        "ground.frame": base,
        "runtime.workers": workers,
        "runtime.max_time_s": max_time_s,
        "record.detail": record,
    }
    resolve = partial(resolve_config, preset, config_file, given, settings or ())
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
