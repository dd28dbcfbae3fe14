# SPDX-License-Identifier: Apache-2.0
"""Summaries of recordings."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from multilica_cli.tables.folding_table import FoldingTable, number_cells
from multilica_cli.tables.result import POSE_COLUMNS, pose_cells

if TYPE_CHECKING:
    from multilica.ingest import SourceSummary, TakenSnapshot

_NS_PER_S = 1_000_000_000


def summary_document(summary: SourceSummary) -> dict[str, Any]:
    """Return the summary as plain values."""
    return {
        "schema": "multilica/inspect/1",
        "source": summary.source,
        "format": summary.format,
        "duration_s": summary.duration_s,
        "clouds": [asdict(cloud) for cloud in summary.clouds],
        "others": [asdict(other) for other in summary.others],
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


def print_summary(summary: SourceSummary, console: Console) -> None:
    """Print the topics and transforms as tables, then the LiDARs that would be used."""
    console.print(f"{summary.source}: {summary.format}{_span(summary)}")
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
            table.add_row(other.topic, other.message_type, str(other.count))
        console.print(table)
    if summary.static_transforms:
        table = FoldingTable("Static transforms", ("parent", "child", *POSE_COLUMNS), numbers_from=2, keys=2)
        for transform in summary.static_transforms:
            table.add_row(transform.target, transform.source, *pose_cells(transform))
        console.print(table)
    for note in summary.notes:
        console.print(f"note: {note}")
    used = [f"{cloud.lidar} ({cloud.frames_taken} of {cloud.frames} frames)" for cloud in summary.clouds if cloud.lidar]
    console.print(f"calibrate would use: {', '.join(used) or 'nothing'}")


def _span(summary: SourceSummary) -> str:
    starts = [cloud.first_ns for cloud in summary.clouds if cloud.first_ns is not None]
    if not starts or summary.duration_s is None:
        return ""
    begin = datetime.fromtimestamp(min(starts) / _NS_PER_S, tz=UTC)
    return f", {begin:%Y-%m-%d %H:%M:%S} UTC, {summary.duration_s:.1f} s"


def recorded_document(taken: TakenSnapshot, out: Path) -> dict[str, Any]:
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


def print_recorded(taken: TakenSnapshot, out: Path, console: Console) -> None:
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
