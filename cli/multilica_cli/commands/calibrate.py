# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate`: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.configuration import ingest_options, resolve_config
from multilica_cli.options import (
    ConfigFile,
    Frames,
    Json,
    McapEncoding,
    Preset,
    PriorSource,
    Quiet,
    Record,
    Settings,
    Sources,
    Start,
    Strict,
    Threads,
    Topics,
    Window,
    WindowSeconds,
)
from multilica_cli.outcome import (
    print_document,
    print_explanation,
    print_placements,
    print_snapshots,
    print_written,
)
from multilica_cli.run import calibrate_sources, default_out_dir, exit_code_of
from multilica_cli.several import calibrate_snapshots
from multilica_cli.terminal import stdout_console

__all__ = ["calibrate"]


def calibrate(
    sources: Sources,
    *,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="LiDAR that the others are placed relative to.",
            show_default="the one with the most overlap",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where results go.", show_default="recordings/runs/<source>")
    ] = None,
    prior: PriorSource = None,
    topics: Topics = None,
    frames: Frames = None,
    start: Start = None,
    window: Window = None,
    window_s: WindowSeconds = None,
    strict: Strict = False,
    preset: Preset = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    until: Annotated[
        str | None, typer.Option(metavar="STAGE", help="Stop after this stage, recording written.")
    ] = None,
    threads: Threads = None,
    ground: Annotated[bool, typer.Option("--ground", help="Estimate roll, pitch and z of the base frame too.")] = False,
    record: Record = None,
    mcap_encoding: McapEncoding = "foxglove",
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Find where every LiDAR sits, and leave the result with its recording in a directory.

    Several recordings are several snapshots of one rig: each is calibrated by itself, then all of them jointly.
    """
    from multilica.ingest import find_snapshots, frames_recorded
    from multilica.ingest.source import locate

    files = [locate(source) for source in sources]
    options = {
        "target": target,
        "until": until,
        **ingest_options(topics, frames, start, window, window_s, strict=strict),
        "ground.enabled": ground or None,
        "runtime.threads": threads,
        "record.detail": record,
    }
    config = resolve_config(preset, config_file, options, settings or (), frames_recorded(files))
    found = find_snapshots(files, config=config.ingest)
    out_dir = out or default_out_dir(sources, len(found))
    if len(found) > 1:
        run = calibrate_snapshots(found, out_dir, config, prior=prior, mcap_encoding=mcap_encoding, quiet=quiet)
    else:
        run = calibrate_sources(found[0].paths, out_dir, config, prior=prior, mcap_encoding=mcap_encoding, quiet=quiet)
    if as_json:
        print_document(run)
    else:
        console = stdout_console(quiet=quiet)
        print_placements(run, console)
        print_snapshots(run, console)
        print_written(run, console)
        print_explanation(run, console)
    return exit_code_of(run.result, config)
