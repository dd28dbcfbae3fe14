# SPDX-License-Identifier: Apache-2.0
"""Parameters of reading a recording."""

from datetime import datetime
from typing import Literal

from pydantic import Field, field_validator

from multilica.config.section import Count, Positive, Section


class IngestConfig(Section):
    """Which part of the recording is read."""

    frames: Count = Field(
        10, description="frames accumulated per LiDAR; a recorded snapshot uses all its frames unless this is given"
    )
    start_s: float = Field(0.0, ge=0.0, description="start of the window, in seconds after the first frame")
    start_at: str = Field(
        "",
        description="start of the window as a time: ISO 8601 (UTC by default), or s or ns since the epoch",
    )
    window: Literal["start", "auto"] = Field(
        "start", description="auto: the longest standstill after start_s; start: the frames right after start_s"
    )
    window_s: float = Field(
        0.0, ge=0.0, description="time over which the frames are spread; 0: consecutive frames, auto: at most 30 s"
    )
    topics: dict[str, str] = Field(
        default_factory=dict, description="LiDAR name -> its topic, or a pattern or type that matches one topic"
    )
    only: tuple[str, ...] = Field(
        (), description="topics, patterns such as /lidar_*/points, or types to use; empty: all topics with point clouds"
    )
    strict: bool = Field(default=False, description="fail if any part of the recording is unreadable")
    max_memory_mb: Positive = Field(
        2000.0, description="memory that reading may take; a source that needs more is refused"
    )
    timeout_s: Positive = Field(30.0, description="seconds after which reading from a live source stops")

    @field_validator("start_at", mode="before")
    @classmethod
    def _as_text(cls, value: object) -> object:
        """Accept the times and numbers of TOML as well."""
        return str(value) if isinstance(value, datetime | int | float) else value
