# SPDX-License-Identifier: Apache-2.0
"""The summary of a source as tables or as a document."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from multilica_cli.tables import POSE_COLUMNS, plain_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from multilica.geometry import RigidTransform
    from multilica.ingest import SourceSummary

__all__ = ["print_summary", "summary_document"]

_NS_PER_S = 1_000_000_000


def summary_document(summary: SourceSummary) -> dict[str, Any]:
    """The summary as plain values."""
    return {
        "schema": "multilica/inspect/1",
        "source": summary.source,
        "format": summary.format,
        "duration_s": summary.duration_s,
        "clouds": [asdict(cloud) for cloud in summary.clouds],
        "others": [asdict(other) for other in summary.others],
        "static_transforms": [_transform(transform) for transform in summary.static_transforms],
        "notes": list(summary.notes),
        "objection": summary.objection,
    }


def print_summary(summary: SourceSummary, console: Console) -> None:
    """The summary for people."""
    console.print(f"{summary.source}: {summary.format}{_span(summary)}")
    if summary.clouds:
        console.print(_cloud_table(summary))
    if summary.others:
        console.print(_other_table(summary))
    if summary.static_transforms:
        console.print(_transform_table(summary))
    for note in summary.notes:
        console.print(f"note: {note}")
    taken = [
        f"{cloud.lidar} ({cloud.frames_taken} of {cloud.frames} frames)" for cloud in summary.clouds if cloud.lidar
    ]
    console.print(f"calibrate would take: {', '.join(taken) or 'nothing'}")


def _span(summary: SourceSummary) -> str:
    starts = [cloud.first_ns for cloud in summary.clouds if cloud.first_ns is not None]
    if not starts or summary.duration_s is None:
        return ""
    begin = datetime.fromtimestamp(min(starts) / _NS_PER_S, tz=UTC)
    return f", {begin:%Y-%m-%d %H:%M:%S} UTC, {summary.duration_s:.1f} s"


def _cloud_table(summary: SourceSummary) -> Table:
    columns = ("LiDAR", "topic", "type", "frame", "scans", "Hz", "points\nper scan", "median\nm", "farthest\nm")
    table = plain_table("Point clouds", columns, numbers_from=4)
    for cloud in summary.clouds:
        table.add_row(
            cloud.lidar or "-",
            cloud.topic,
            cloud.message_type.rpartition("/")[2],
            cloud.frame_id,
            str(cloud.frames),
            _number(cloud.rate_hz),
            str(cloud.points_median),
            _number(cloud.range_median_m),
            _number(cloud.range_max_m),
        )
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _other_table(summary: SourceSummary) -> Table:
    table = plain_table("Other topics", ("topic", "type", "messages"), numbers_from=2)
    for other in summary.others:
        table.add_row(other.topic, other.message_type, str(other.count))
    return table


def _transform_table(summary: SourceSummary) -> Table:
    columns = ("parent", "child", *POSE_COLUMNS)
    table = plain_table("Static transforms of the recording", columns, numbers_from=2)
    for transform in summary.static_transforms:
        numbers = (*(f"{value:z.3f}" for value in transform.xyz_m), *(f"{value:z.2f}" for value in transform.rpy_deg))
        table.add_row(transform.target, transform.source, *numbers)
    return table


def _transform(transform: RigidTransform) -> dict[str, Any]:
    return {
        "parent": transform.target,
        "child": transform.source,
        "xyz_m": transform.xyz_m.tolist(),
        "rpy_deg": transform.rpy_deg.tolist(),
        "quaternion_xyzw": transform.quaternion_xyzw.tolist(),
    }
