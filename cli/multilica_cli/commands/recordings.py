# SPDX-License-Identifier: Apache-2.0
"""Commands that read recordings without calibrating: `inspect`, `record`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console

from multilica.errors import UnfitSnapshotError, UsageError, listed
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import (
    LIVE_SOURCE,
    Json,
    Parameters,
    Quiet,
    Reading,
    Timeout,
    argument,
    located,
    mcap_name,
    option,
    stops_value,
)
from multilica_cli.terminal import (
    POSE_COLUMNS,
    FoldingTable,
    number_cells,
    pose_cells,
    print_json,
    stderr_console,
    stdout_console,
)

if TYPE_CHECKING:
    from multilica.ingest import SourceSummary, StopAdvice, TakenSnapshot
    from multilica.snapshot import Snapshot

_NS_PER_S = 1_000_000_000


def inspect(
    sources: Annotated[list[str], argument("SOURCE", f"As for calibrate: recordings, {LIVE_SOURCE}.")],
    *,
    reading: Reading,
    timeout_s: Timeout = None,
    as_json: Json = False,
) -> None:
    """List the topics of a recording or a running vehicle, and those that calibrate would use."""
    from multilica.ingest import frames_recorded, inspect_source
    from multilica_cli.progress import tell_listening

    files = located(sources)
    config = Parameters().resolve(reading.values | {"ingest.timeout_s": timeout_s}, frames_recorded(files))
    tell_listening(files, config.ingest, quiet=as_json)
    summary = inspect_source(files, config=config.ingest)
    if as_json:
        print_json(_summary_document(summary))
    else:
        _print_summary(summary, stdout_console())
    if summary.objection:
        raise UnfitSnapshotError(summary.objection)


def record(
    sources: Annotated[list[str], argument("SOURCE", f"As for calibrate: recordings, {LIVE_SOURCE}.")],
    *,
    out: Annotated[Path, option("--out FILE.mcap", "File to write.", callback=mcap_name)],
    vehicle: Annotated[str, option("--vehicle NAME", "Name of the vehicle, stored in the file.")] = "",
    reading: Reading,
    stops: Annotated[
        str | None,
        option(
            "--stops auto|N",
            "Stops of a drive to save: of a log, as for calibrate, or of a running vehicle, whose driver is told "
            "where to stop and when to drive on; auto: up to four.",
            "1",
        ),
    ] = None,
    timeout_s: Timeout = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Save the snapshot that calibrate would use as a small MCAP file; calibrating that file gives the same result.

    With --stops N, the driver of a running vehicle is told when a stop is good; each good stop is saved at once.
    """
    from multilica.ingest import frames_recorded, take_snapshot
    from multilica.sinks.snapshots import window_metadata, write_snapshot_mcap
    from multilica_cli.progress import show_listening, tell_listening

    # An address, taken for a path, lies nowhere above a file that exists.
    if out.exists() and any(out.resolve().is_relative_to(Path(source).resolve()) for source in sources):
        raise UsageError(f"Found --out {out}, which belongs to the source itself; expected another place.")
    files = located(sources)
    given = reading.values | {"ingest.timeout_s": timeout_s, "drive.stops": stops_value(stops or "1")}
    resolved = Parameters().resolve(given, frames_recorded(files))
    config = resolved.ingest
    if resolved.drive.stops == 1:
        tell_listening(files, config, quiet=quiet)
        with show_listening(config.frames, quiet=quiet) as observe:
            taken = take_snapshot(files, config=config, observe=observe)
        out.parent.mkdir(parents=True, exist_ok=True)
        write_snapshot_mcap(taken.snapshot, out, metadata=window_metadata(config, vehicle))
    else:
        from multilica.ingest import take_stops

        def save(snapshot: Snapshot, spans: Sequence[tuple[int, int]]) -> None:
            out.parent.mkdir(parents=True, exist_ok=True)
            write_snapshot_mcap(snapshot, out, metadata=window_metadata(config, vehicle, spans))

        told = _Advice(stderr_console(quiet=quiet))
        taken = take_stops(files, resolved.drive.stops, save, told, config=config)
    if as_json:
        print_json(_recorded_document(taken, out))
    else:
        _print_recorded(taken, out, stdout_console(quiet=quiet))
    if not taken.silent:
        return ExitCode.DONE
    stderr_console().print(
        f"multilica: {taken.snapshot.source} sent no readable scan on {listed(taken.silent)}; "
        f"{out} holds only the other LiDARs."
    )
    return ExitCode.NOT_PLACED


class _Advice:
    """A line per advice to the driver that differs from the one before."""

    def __init__(self, console: Console) -> None:
        self._console, self._before = console, ""

    def __call__(self, advice: StopAdvice) -> None:
        if advice.text != self._before:
            self._console.print(advice.text, soft_wrap=True)
        self._before = advice.text


def _summary_document(summary: SourceSummary) -> dict[str, Any]:
    """Return the summary as plain values; the count of other topics is None for a running vehicle."""
    return {
        "schema": "multilica/inspect/1",
        "source": summary.source,
        "format": summary.format,
        "taken_for": dict(summary.taken_for),
        "standstills": [asdict(each) for each in summary.standstills],
        "standstill_evidence": summary.standstill_evidence,
        "duration_s": summary.duration_s,
        "clouds": [asdict(cloud) for cloud in summary.clouds],
        "others": [
            {
                "topic": other.name,
                "message_type": other.message_type,
                "count": None if summary.live else other.count,
            }
            for other in summary.others
        ],
        "static_transforms": [
            {
                "parent": transform.target,
                "child": transform.source,
                "xyz_m": transform.xyz_m.tolist(),
                "rpy_deg": transform.rpy_deg.tolist(),
                "quaternion_xyzw": transform.quaternion_xyzw.tolist(),
            }
            for transform in summary.static_transforms
        ],
        "notes": list(summary.notes),
        "objection": summary.objection,
    }


def _print_summary(summary: SourceSummary, console: Console) -> None:
    """Print the topics and transforms as tables, then the LiDARs that would be used."""
    _print_sources(summary, console)
    if summary.clouds:
        columns = ("LiDAR", "topic", "type", "frame", "scans", "Hz", "points\nper scan", "median\nm", "max\nm")
        table = FoldingTable("Point clouds", columns, numbers_from=4, keys=2, spare=("type",))
        for cloud in summary.clouds:
            names = (cloud.lidar or "-", cloud.topic, cloud.message_type.rpartition("/")[2], cloud.frame_id)
            rate, *ranges = number_cells((cloud.rate_hz, cloud.range_median_m, cloud.range_max_m), 1.0, 1)
            table.add_row(*names, str(cloud.frames), rate, str(cloud.points_median), *ranges)
        console.print(table)
    if summary.others:
        table = FoldingTable("Other topics", ("topic", "type", "messages"), numbers_from=2, keys=2)
        for other in summary.others:
            table.add_row(other.name, other.message_type, "-" if summary.live else str(other.count))
        console.print(table)
    if summary.static_transforms:
        table = FoldingTable("Static transforms", ("parent", "child", *POSE_COLUMNS), numbers_from=2, keys=2)
        for transform in summary.static_transforms:
            table.add_row(transform.target, transform.source, *pose_cells(transform))
        console.print(table)
    for note in summary.notes:
        console.print(f"note: {note}")
    used = [f"{cloud.lidar} ({cloud.frames_taken} of {cloud.frames} frames)" for cloud in summary.clouds if cloud.lidar]
    stops = " at each stop" if len(summary.standstills) > 1 else ""
    console.print(f"calibrate would use{stops}: {', '.join(used) or 'nothing'}")


def _print_sources(summary: SourceSummary, console: Console) -> None:
    console.print(f"{summary.source}: {summary.format}{_span(summary)}")
    if len(summary.taken_for) > 1:
        for source, content in summary.taken_for.items():
            console.print(f"{source} is taken for {content}")
    if summary.standstills:
        times = (f"{each.start_s:.1f} s for {each.length_s:.1f} s" for each in summary.standstills)
        console.print(f"The vehicle stands still, by {summary.standstill_evidence}: from {', '.join(times)}")


def _span(summary: SourceSummary) -> str:
    starts = [cloud.first_ns for cloud in summary.clouds if cloud.first_ns is not None]
    if not starts or summary.duration_s is None:
        return ""
    begin = datetime.fromtimestamp(min(starts) / _NS_PER_S, tz=UTC)
    return f", {begin:%Y-%m-%d %H:%M:%S} UTC, {summary.duration_s:.1f} s"


def _recorded_document(taken: TakenSnapshot, out: Path) -> dict[str, Any]:
    """Return the summary as plain values; `source_bytes` is None for a running vehicle."""
    return {
        "schema": "multilica/record/1",
        "source": taken.snapshot.source,
        "source_bytes": taken.source_bytes,
        "out": str(out),
        "out_bytes": out.stat().st_size,
        "lidars": [
            {
                "lidar": lidar.name,
                "topic": lidar.topic,
                "frame_id": lidar.frame_id,
                "frames": len(lidar.scans),
                "points": lidar.points_count,
                "first_ns": lidar.scans[0].stamp_ns,
                "last_ns": lidar.scans[-1].stamp_ns,
            }
            for lidar in taken.snapshot.lidars
        ],
        "static_transforms": len(taken.snapshot.static_transforms),
        "silent": list(taken.silent),
        "notes": list(taken.snapshot.notes),
    }


def _print_recorded(taken: TakenSnapshot, out: Path, console: Console) -> None:
    """Print the summary as a table."""
    snapshot = taken.snapshot
    columns = ("LiDAR", "topic", "frame", "scans", "over\ns", "points\nper scan")
    table = FoldingTable(f"Recorded from {snapshot.source}", columns, numbers_from=3, keys=1)
    for lidar in snapshot.lidars:
        scans = len(lidar.scans)
        over_s = (lidar.scans[-1].stamp_ns - lidar.scans[0].stamp_ns) / _NS_PER_S
        points = str(lidar.points_count // scans)
        table.add_row(lidar.name, lidar.topic, lidar.frame_id, str(scans), f"{over_s:.1f}", points)
    console.print(table)
    for note in snapshot.notes:
        console.print(f"note: {note}")
    before = "" if taken.source_bytes is None else f" of {_size(taken.source_bytes)}"
    console.print(f"wrote {out}: {_size(out.stat().st_size)}{before}")


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.1f} MB" if size_bytes >= 1e6 else f"{size_bytes / 1e3:.1f} kB"
