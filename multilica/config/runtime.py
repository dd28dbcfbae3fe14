# SPDX-License-Identifier: Apache-2.0
"""Parameters of the run itself."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, Positive, Section

__all__ = ["RecordConfig", "RuntimeConfig"]


class RuntimeConfig(Section):
    """Threads and random numbers."""

    threads: Count = Field(1, description="threads; with one the same input gives the same bits")
    seed: int = Field(0, ge=0, description="seed of everything random")


class RecordConfig(Section):
    """Size of recording.rrd."""

    detail: Literal["full", "normal", "slim"] = Field(
        "normal",
        description="full: every point and match; normal: clouds up to half a million points, a sample of the "
        "matches; slim: no raw clouds and descriptors, small samples of the rest",
    )
    max_megabytes: Positive = Field(
        100.0, description="a larger recording is thinned to this size, which its log says; full: no limit"
    )
