# SPDX-License-Identifier: Apache-2.0
"""Commands that read recordings without calibrating: `inspect`, `record`."""

from pathlib import Path
from typing import Annotated

from multilica.errors import UnfitSnapshotError, UsageError
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import Json, Parameters, Quiet, Reading, Sources, argument, mcap_name, option
from multilica_cli.terminal import print_json, stderr_console, stdout_console


def inspect(sources: Sources, *, reading: Reading, as_json: Json = False) -> None:
    """List the topics of a recording, and those that calibrate would use."""
    from multilica.ingest import frames_recorded, inspect_source
    from multilica.ingest.locate import locate
    from multilica_cli.tables.source import print_summary, summary_document

    files = [locate(source) for source in sources]
    config = Parameters().resolve(reading.values, frames_recorded(files))
    summary = inspect_source(files, config=config.ingest)
    if as_json:
        print_json(summary_document(summary))
    else:
        print_summary(summary, stdout_console())
    if summary.objection:
        raise UnfitSnapshotError(summary.objection)


def record(
    sources: Annotated[
        list[str], argument("SOURCE", "As for calibrate, or ws://HOST:PORT of a vehicle that runs foxglove_bridge.")
    ],
    *,
    out: Annotated[Path, option("--out FILE.mcap", "File to write.", show_default=False, callback=mcap_name)],
    vehicle: Annotated[str, option("--vehicle NAME", "Name of the vehicle, stored in the file.")] = "",
    reading: Reading,
    timeout_s: Annotated[
        float | None, option("--timeout S", "Stop listening to a running vehicle after S seconds.")
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Save the snapshot that calibrate would use as a small MCAP file; calibrating that file gives the same result."""
    from multilica.ingest import frames_recorded, take_snapshot
    from multilica.ingest.locate import locate
    from multilica.ingest.remote.address import is_live
    from multilica.sinks.mcap.snapshot_mcap import window_metadata, write_snapshot_mcap
    from multilica_cli.progress import show_listening
    from multilica_cli.tables.source import print_recorded, recorded_document

    # An address, taken for a path, lies nowhere above a file that exists.
    if out.exists() and any(out.resolve().is_relative_to(Path(source).resolve()) for source in sources):
        raise UsageError(f"Found --out {out}, which belongs to the source itself; expected another place.")
    files = [source if is_live(source) else locate(source) for source in sources]
    given = reading.values | {"ingest.timeout_s": timeout_s}
    config = Parameters().resolve(given, frames_recorded(files)).ingest
    if any(is_live(source) for source in sources):
        listening = f"listening for {config.frames} scans of each LiDAR, at most {config.timeout_s:g} s"
        stderr_console(quiet=quiet).print(listening)
    with show_listening(config.frames, quiet=quiet) as observe:
        taken = take_snapshot(files, config=config, observe=observe)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(taken.snapshot, out, metadata=window_metadata(config, vehicle))
    if as_json:
        print_json(recorded_document(taken, out))
    else:
        print_recorded(taken, out, stdout_console(quiet=quiet))
    if not taken.silent:
        return ExitCode.DONE
    stderr_console().print(
        f"multilica: {taken.snapshot.source} sent no readable scan on {', '.join(taken.silent)}; "
        f"{out} holds only the other LiDARs."
    )
    return ExitCode.NOT_PLACED
