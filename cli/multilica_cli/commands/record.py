# SPDX-License-Identifier: Apache-2.0
"""`multilica record`: the snapshot of a log or of a running vehicle as a small file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from multilica.errors import UsageError
from multilica_cli.configuration import ingest_options, resolve_config
from multilica_cli.failures import ExitCode
from multilica_cli.options import Frames, Json, Quiet, Start, Strict, Topics, Window, WindowSeconds, mcap_name
from multilica_cli.terminal import stderr_console, stdout_console

__all__ = ["record"]


def record(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="What calibrate takes, or ws://HOST:PORT of a vehicle that runs foxglove_bridge.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[
        Path, typer.Option(metavar="FILE.mcap", help="The snapshot.", show_default=False, callback=mcap_name)
    ],
    vehicle: Annotated[str, typer.Option(metavar="NAME", help="Name of the vehicle, kept in the file.")] = "",
    topics: Topics = None,
    frames: Frames = None,
    start: Start = None,
    window: Window = None,
    window_s: WindowSeconds = None,
    strict: Strict = False,
    timeout_s: Annotated[
        float | None,
        typer.Option("--timeout", metavar="S", help="Seconds after which a running vehicle is listened to no longer."),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Write what calibrate would take into one small indexed MCAP; calibrate on it gives the same."""
    from multilica.ingest import frames_recorded, take_snapshot
    from multilica.ingest.address import is_live
    from multilica.ingest.source import locate
    from multilica.sinks.snapshot_mcap import write_snapshot_mcap
    from multilica.sinks.snapshot_metadata import window_metadata
    from multilica_cli.listening import show_listening
    from multilica_cli.recorded_tables import print_recorded, recorded_document

    _require_out(out, sources)
    files = [source if is_live(source) else locate(source) for source in sources]
    options = ingest_options(topics, frames, start, window, window_s, strict=strict) | {"ingest.timeout_s": timeout_s}
    config = resolve_config(None, None, options, (), frames_recorded(files)).ingest
    messages = stderr_console(quiet=quiet)
    if any(is_live(source) for source in sources):
        messages.print(f"listening for {config.frames} scans of each LiDAR, at most {config.timeout_s:g} s")
    with show_listening(messages, config.frames) as observe:
        taken = take_snapshot(files, config=config, observe=observe)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(taken.snapshot, out, metadata=window_metadata(config, vehicle))
    if as_json:
        typer.echo(json.dumps(recorded_document(taken, out), indent=2))
    else:
        print_recorded(taken, out, stdout_console(quiet=quiet))
    if taken.silent:
        stderr_console().print(
            f"multilica: {taken.snapshot.source} sent no scan that can be read on {', '.join(taken.silent)}; "
            f"{out} holds the other LiDARs only."
        )
        return ExitCode.NOT_PLACED
    return ExitCode.DONE


def _require_out(out: Path, sources: list[str]) -> None:
    # An address, taken for a path, lies nowhere above a file that exists.
    if out.exists() and any(out.resolve().is_relative_to(Path(source).resolve()) for source in sources):
        raise UsageError(f"Found --out {out}, which belongs to the source itself; expected another place.")
