# SPDX-License-Identifier: Apache-2.0
"""What was dropped of each LiDAR, with the reason, as markdown."""

from __future__ import annotations

from collections.abc import Sequence

from multilica.config import CalibrationConfig
from multilica.sinks.markdown import markdown_table
from multilica.sinks.run_story import RunStory

__all__ = ["dropped_markdown"]


def dropped_markdown(story: RunStory) -> str:
    """Per LiDAR what is left and what is not, with the meaning of each reason."""
    reasons = sorted({reason for cloud in story.clouds.values() for reason in cloud.dropped_m})
    header = ("LiDAR", "returns", *reasons, "kept", "after thinning")
    table = markdown_table(header, [_row(story, lidar, reasons) for lidar in story.lidars])
    meanings = "\n".join(f"- `{reason}`: {_meaning(reason, story.config)}" for reason in reasons)
    return f"# Dropped points\n\n{table}\n\n{meanings}"


def _row(story: RunStory, lidar: str, reasons: Sequence[str]) -> Sequence[str]:
    total = next(each.points_count for each in story.snapshot.lidars if each.name == lidar) if story.snapshot else 0
    if lidar not in story.clouds:
        return (lidar, f"{total:,}", *("-" for _ in reasons), "-", "-")
    cloud = story.clouds[lidar]
    dropped = (len(cloud.dropped_m.get(reason, ())) for reason in reasons)
    return (
        lidar,
        f"{total:,}",
        *(f"{count:,}" for count in dropped),
        *_left(len(cloud.returns_m), len(cloud.points_m)),
    )


def _left(kept: int, thinned: int) -> tuple[str, str]:
    return f"{kept:,}", f"{thinned:,}" if kept else "**none**"


def _meaning(reason: str, config: CalibrationConfig | None) -> str:
    """In words, with the parameter that decides."""
    if config is None:
        return ""
    limits = config.preprocess
    return {
        "too_near": f"nearer than {limits.min_range_m:g} m, the vehicle's own body (`preprocess.min_range_m`)",
        "too_far": f"farther than {limits.max_range_m:g} m (`preprocess.max_range_m`)",
        "moving": "moved between frames: other frames' beams pass through its place (`stillness.beyond_m`)",
    }.get(reason, "")
