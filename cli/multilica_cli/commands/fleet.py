# SPDX-License-Identifier: Apache-2.0
"""`multilica fleet`: many logs as one table of extrinsics over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from multilica_cli import options
from multilica_cli.commands.check import tolerances_of
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import argument, option, output
from multilica_cli.terminal import print_json, stderr_console, stdout_console

if TYPE_CHECKING:
    from multilica.fleet.store.store import Store

fleet = options.App(
    name="fleet",
    no_args_is_help=True,
    help="Turn many logs into one table of extrinsics over time.",
    short_help="Turn many logs into one table of extrinsics over time.",
)

_Format = Annotated[
    Literal["table", "csv", "json"],
    option("--format table|csv|json", "Form of the answer; json: an object per line."),
]

_Nominal = Annotated[
    Path | None,
    option(
        "--nominal FILE", "Poses as designed, to find wrong ones: TOML, URDF or another file of poses.", default=False
    ),
]


@fleet.command()
def run(
    logs: Annotated[
        list[str],
        argument(
            "LOGS",
            "Folders, files, globs, s3:// or gs:// prefixes, or a manifest: CSV or Parquet with the columns source, "
            "vehicle and time.",
        ),
    ],
    *,
    out: Annotated[str, option("--out STORE", "Folder, or s3://BUCKET/PREFIX, for tables and files.", default=False)],
    pattern: Annotated[
        str | None,
        option(
            "--pattern PATTERN",
            "Vehicle and time in the paths of logs, such as {vehicle}/{time:%Y-%m-%d}.",
            "from the log's metadata, else its folder's name",
        ),
    ] = None,
    calibrate: Annotated[
        Literal["when-needed", "always"],
        option(
            "--calibrate WHEN", "always, or when-needed: only where the vehicle's last accepted poses no longer hold."
        ),
    ] = "when-needed",
    target: Annotated[str | None, option("--target NAME", "LiDAR that all poses are relative to.", "chosen")] = None,
    max_translation_m: Annotated[
        float, option("--max-translation M", "Largest distance that does not count as motion.", min=1e-6)
    ] = 0.03,
    max_rotation_deg: Annotated[
        float, option("--max-rotation DEG", "Largest rotation that does not count as motion.", min=1e-6)
    ] = 0.3,
    workers: Annotated[
        int | None, option("--workers N", "Logs at once, each with one thread of a process.", "one per core", min=1)
    ] = None,
    scheduler: Annotated[
        str,
        option(
            "--scheduler ADDRESS",
            "Dask scheduler to run on instead: tcp://HOST:PORT or tls://HOST:PORT.",
            default=False,
        ),
    ] = "",
    max_log_time_s: Annotated[float, option("--max-log-time S", "Time limit of a log, in seconds.", min=1.0)] = 600.0,
    max_log_memory_mb: Annotated[float, option("--max-log-memory MB", "Memory limit of a log.", min=100.0)] = 4000.0,
    retries: Annotated[int, option("--retries N", "Tries after a lost connection or a kill.", min=0)] = 5,
    newest_first: Annotated[bool, option("--newest-first", "Begin with the newest logs.")] = False,
    topics: options.Topics = None,
    frames: options.Frames = None,
    stops: Annotated[
        str | None,
        option(
            "--stops auto|N",
            "Standstills of a log to use, each as a snapshot; auto: up to four that differ in place and see much.",
            "auto; 1 with --window",
        ),
    ] = None,
    window: Annotated[
        Literal["start", "auto"] | None,
        option(
            "--window start|auto",
            "If a log has not several stops, auto: use its longest standstill; start: its first frames.",
            "auto",
        ),
    ] = None,
    config_file: options.ConfigFile = None,
    settings: options.Settings = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Verify or calibrate each log that the store does not have yet; an interrupted run continues.

    Exits with 0 if every log has a result, 4 if a log of this run was refused or failed.
    """
    from multilica.fleet.fleet_run import FleetOptions, run_fleet
    from multilica.fleet.patterns import LogPattern
    from multilica.fleet.store.store import open_store
    from multilica.fleet.tasks.guard import LogTaskLimits
    from multilica_cli.progress import show_fleet

    given = {
        **options.Reading(topics, frames, window=window or "auto").values,
        "target": target,
        "drive.stops": options.stops_value(stops if window is None else stops or "1"),
    }
    config = options.Parameters(None, config_file, settings).resolve({**given, "runtime.workers": 1})
    chosen = FleetOptions(
        config,
        tolerances_of(max_translation_m, max_rotation_deg),
        calibrate,
        LogPattern(pattern) if pattern else None,
        newest_first,
        workers or len(os.sched_getaffinity(0)),
        scheduler,
        LogTaskLimits(time_s=max_log_time_s, memory_mb=max_log_memory_mb, retries=retries),
    )
    store = open_store(out, create=True)
    with show_fleet(quiet=quiet or as_json) as observe:
        outcome = run_fleet(logs, store, chosen, observe)
    if as_json:
        unlike = {"unlike_pattern": outcome.unlike_pattern} if pattern else {}
        print_json({"found": outcome.found, "skipped": outcome.skipped, **unlike, **outcome.states})
    else:
        counts = ", ".join(f"{count} {state}" for state, count in sorted(outcome.states.items())) or "nothing to do"
        console = stdout_console(quiet=quiet)
        console.print(f"{outcome.found} logs, {outcome.skipped} of them finished before: {counts}.")
        if outcome.without_result:
            console.print(f"For the reasons: multilica fleet failures --store {store}")
    return ExitCode.NOT_PLACED if outcome.without_result else ExitCode.DONE


@fleet.command()
def query(
    sql: Annotated[str, argument("SQL", "Question in the SQL of DuckDB; tables: lidars, logs.")],
    *,
    store: options.FleetStore,
    form: _Format = "table",
) -> None:
    """Query the tables `lidars` (a row per LiDAR and log) and `logs` in SQL."""
    _print_answer(_opened(store), sql, form)


@fleet.command()
def status(*, store: options.FleetStore, form: _Format = "table") -> None:
    """List the vehicles: logs by outcome, and LiDARs without a certain pose in the last one; without damaged parts."""
    from multilica.fleet.store.query import ask_status
    from multilica_cli.terminal import print_answer

    answer, damaged = ask_status(_opened(store))
    if damaged:
        stderr_console().print(
            f"note: parts that are damaged and left out: {len(damaged)}; "
            f"`multilica fleet repair --store {store}` sets them aside."
        )
    print_answer(answer, form, stdout_console(), keys=1)


@fleet.command()
def failures(*, store: options.FleetStore, form: _Format = "table") -> None:
    """List the logs without a result and the LiDARs without a certain pose, by cause, with their recordings."""
    from multilica.fleet.store.query import FAILURES

    _print_answer(_opened(store), FAILURES, form)


@fleet.command()
def show(
    vehicle: Annotated[str, argument("VEHICLE", "Name of the vehicle.")],
    *,
    store: options.FleetStore,
    form: _Format = "table",
) -> None:
    """List the poses of each LiDAR of a vehicle, log by log."""
    from multilica.fleet.store.query import HISTORY, require_vehicle

    opened = _opened(store)
    require_vehicle(opened, vehicle)
    _print_answer(opened, HISTORY, form, [vehicle], keys=2)


@fleet.command()
def drift(
    *,
    store: options.FleetStore,
    nominal: _Nominal = None,
    false_alarm_rate: Annotated[
        float, option("--false-alarm-rate SHARE", "Share of unmoved LiDARs that are reported nevertheless.")
    ] = 0.001,
    as_json: options.Json = False,
) -> int:
    """List the LiDARs that jumped, creep, are lost or are not at their design pose, with dates and figures.

    Exits with 0 if there are none, else with 5.
    """
    from multilica.exports import read_extrinsics
    from multilica.fleet.drift.drift import find_drift, find_offsets, find_outages
    from multilica.fleet.drift.findings import drift_document
    from multilica.fleet.lidar_series import read_series

    opened = _opened(store)
    series = list(read_series(opened))
    events = find_drift(series, false_alarm_rate)
    offsets = find_offsets(series, read_extrinsics(nominal) if nominal else None, false_alarm_rate)
    outages = find_outages(opened)
    if as_json:
        print_json(drift_document(events, offsets, outages))
    else:
        vehicles = {each.vehicle for each in series if len(each)}
        sentences = [each.sentence for found in (events, offsets, outages) for each in found]
        for sentence in sentences or [f"No LiDAR of {len(vehicles)} vehicles has moved."]:
            stdout_console().print(sentence)
    return ExitCode.DIFFERENT if events or offsets or outages else ExitCode.DONE


@fleet.command()
def report(
    *,
    store: options.FleetStore,
    out: Annotated[Path, output("--out FILE", "File to write.")] = Path("fleet-report.html"),
    nominal: _Nominal = None,
    quiet: options.Quiet = False,
) -> None:
    """Write one HTML page: LiDARs that moved, vehicles, failures by cause, and the pose of each LiDAR over time."""
    from multilica.exports import read_extrinsics
    from multilica.fleet.report.page import store_report
    from multilica.sinks.files.atomic import write_text_atomically

    designed = read_extrinsics(nominal) if nominal else None
    page = store_report(_opened(store), out, designed)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text_atomically(out, page)
    stdout_console(quiet=quiet).print(f"wrote {out}")


@fleet.command()
def compact(*, store: options.FleetStore, quiet: options.Quiet = False) -> None:
    """Join the small parts of each vehicle and month into one; do not use it while a run writes into the store."""
    from multilica.fleet.store.upkeep import compact_store

    before, after = compact_store(_opened(store))
    stdout_console(quiet=quiet).print(f"{before} parts are now {after}.")


@fleet.command()
def repair(*, store: options.FleetStore, quiet: options.Quiet = False) -> None:
    """Set damaged parts of the tables aside, so that the next run treats their logs again; not while a run writes."""
    from multilica.fleet.store.repair import ASIDE, repair_store

    opened, console = _opened(store), stdout_console(quiet=quiet)
    done = repair_store(opened)
    if not done.parts:
        console.print("No part is damaged.")
        return
    for path in done.parts:
        console.print(f"{path} is damaged; it is now in {opened}/{ASIDE}.")
    for vehicle, source in done.logs:
        console.print(f"{vehicle}: {source}: the next run treats it again.")
    if done.unnamed:
        console.print(f"{done.unnamed} of the parts held rows of logs, of which some may not be named here.")


@fleet.command()
def prune(
    *,
    store: options.FleetStore,
    success_days: Annotated[
        float, option("--successes DAYS", "Keep those of runs that placed every LiDAR.", min=0.0, max=1e5)
    ] = 30.0,
    failure_days: Annotated[
        float, option("--failures DAYS", "Keep those of all other runs.", min=0.0, max=1e5)
    ] = 365.0,
    quiet: options.Quiet = False,
) -> None:
    """Remove old recordings, reports and MCAP files; tables and poses are kept."""
    from multilica.fleet.store.upkeep import prune_recordings

    files, size_bytes = prune_recordings(_opened(store), success_days=success_days, failure_days=failure_days)
    stdout_console(quiet=quiet).print(f"{files} files removed, {size_bytes / 1e6:.1f} MB.")


@fleet.command()
def browse(
    *,
    store: options.FleetStore,
    vehicle: Annotated[str | None, option("--vehicle NAME", "Only this one.", "all")] = None,
    host: Annotated[str, option("--host ADDRESS", "Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, option("--port N", "Port to listen on.")] = 51234,
) -> None:
    """Serve the recordings as a catalog of Rerun's viewer, a dataset per vehicle, until Ctrl-C."""
    from multilica.fleet.store.upkeep import lay_out_catalog
    from multilica.scratch import scratch_folder
    from multilica.sinks.rerun.viewer import serve_catalog

    with scratch_folder() as folder:
        datasets = lay_out_catalog(_opened(store), folder, vehicle)
        stdout_console().print(f"{len(datasets)} datasets; open them with: rerun rerun+http://{host}:{port}")
        serve_catalog(datasets, host, port)


def _opened(address: str) -> Store:
    from multilica.fleet.store.store import open_store

    return open_store(address, create=False)


def _print_answer(
    store: Store, sql: str, form: Literal["table", "csv", "json"], values: Sequence[object] = (), *, keys: int = 1
) -> None:
    from multilica.fleet.store.query import ask
    from multilica_cli.terminal import print_answer

    with ask(store, sql, values) as answer:
        print_answer(answer, form, stdout_console(), keys=keys)
