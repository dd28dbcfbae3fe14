# SPDX-License-Identifier: Apache-2.0
"""Dropped points of each LiDAR as markdown."""

from collections.abc import Sequence

from multilica.config import CalibrationConfig
from multilica.sinks.run_state import RunState
from multilica.sinks.text.markdown import markdown_table

__all__ = ["dropped_markdown"]


def dropped_markdown(state: RunState) -> str:
    """Tabulate returns, dropped points by reason and kept points of every LiDAR."""
    reasons = sorted({reason for cloud in state.clouds.values() for reason in cloud.dropped_m})
    header = ("LiDAR", "returns", *reasons, "kept", "after thinning")
    table = markdown_table(header, [_row(state, lidar, reasons) for lidar in state.lidars])
    meanings = "\n".join(f"- `{reason}`: {_meaning(reason, state.config)}" for reason in reasons)
    return f"# Dropped points\n\n{table}\n\n{meanings}"


def _row(state: RunState, lidar: str, reasons: Sequence[str]) -> Sequence[str]:
    total = next(each.points_count for each in state.snapshot.lidars if each.name == lidar) if state.snapshot else 0
    if lidar not in state.clouds:
        return (lidar, f"{total:,}", *("-" for _ in reasons), "-", "-")
    cloud = state.clouds[lidar]
    dropped = (len(cloud.dropped_m.get(reason, ())) for reason in reasons)
    return (
        lidar,
        f"{total:,}",
        *(f"{count:,}" for count in dropped),
        f"{len(cloud.returns_m):,}",
        f"{len(cloud.points_m):,}" if len(cloud.returns_m) else "**none**",
    )


def _meaning(reason: str, config: CalibrationConfig | None) -> str:
    """Describe a reason with the parameter that decides."""
    if config is None:
        return ""
    limits = config.preprocess
    return {
        "too_near": f"nearer than {limits.min_range_m:g} m, such as the vehicle's own body (`preprocess.min_range_m`)",
        "too_far": f"farther than {limits.max_range_m:g} m (`preprocess.max_range_m`)",
        "moving": "moved between frames: beams of other frames pass through its place (`stillness.beyond_m`)",
    }.get(reason, "")
