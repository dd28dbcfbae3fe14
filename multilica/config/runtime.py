# SPDX-License-Identifier: Apache-2.0
"""Parameters of the run itself."""

from typing import Literal

from pydantic import Field

from multilica.config.section import NotNegative, Positive, Section


class RuntimeConfig(Section):
    """Worker processes and random numbers."""

    workers: int = Field(
        0,
        ge=0,
        description="worker processes; 0: one per core that this process may use; 1: none, this process does all work; "
        "any number gives the same result",
    )
    max_time_s: NotNegative = Field(
        0.0,
        description="no search starts later than this after the start; 0: no limit; with one, equal runs may differ",
    )
    seed: int = Field(0, ge=0, description="seed of everything random")


class RecordConfig(Section):
    """Size of recording.rrd."""

    detail: Literal["full", "normal", "slim"] = Field(
        "normal",
        description="full: every point and match; normal: clouds up to half a million points, a sample of the "
        "matches; slim: no raw clouds and descriptors, small samples of the rest",
    )
    max_megabytes: Positive = Field(
        100.0, description="a larger recording is thinned to this size, and its log says so; full: no limit"
    )
