# SPDX-License-Identifier: Apache-2.0
"""What was recorded, as a table or as a document."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from multilica_cli.tables import plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.ingest import TakenSnapshot

__all__ = ["print_recorded", "recorded_document"]

_KB = 1e3
_MB = 1e6
_NS_PER_S = 1e9


def recorded_document(taken: TakenSnapshot, out: Path) -> dict[str, Any]:
    """What was recorded as plain values; `source_bytes` is null for a running vehicle."""
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
    """What was recorded for people."""
    snapshot = taken.snapshot
    columns = ("LiDAR", "topic", "frame", "scans", "over\ns", "points\nper scan")
    table = plain_table(f"Taken from {snapshot.source}", columns, numbers_from=3)
    for lidar in snapshot.lidars:
        over_s = (lidar.scans[-1].stamp_ns - lidar.scans[0].stamp_ns) / _NS_PER_S
        table.add_row(
            lidar.name,
            lidar.topic,
            lidar.frame_id,
            str(len(lidar.scans)),
            f"{over_s:.1f}",
            str(lidar.points_count // len(lidar.scans)),
        )
    console.print(table)
    for note in snapshot.notes:
        console.print(f"note: {note}")
    before = "" if taken.source_bytes is None else f" of {_size(taken.source_bytes)}"
    console.print(f"wrote {out}: {_size(out.stat().st_size)}{before}")


def _size(size_bytes: int) -> str:
    return f"{size_bytes / _MB:.1f} MB" if size_bytes >= _MB else f"{size_bytes / _KB:.1f} kB"
