# SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from multilica.errors import UsageError

__all__ = [
    "ConfigFile",
    "Frames",
    "Json",
    "McapEncoding",
    "Preset",
    "PriorSource",
    "Quiet",
    "Record",
    "Settings",
    "Sources",
    "Start",
    "Strict",
    "Threads",
    "Topics",
    "Window",
    "WindowSeconds",
    "mcap_name",
]

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="SOURCE",
        help="An MCAP file, a ROS 1 or ROS 2 bag, a directory of PCD, PLY or other point files, or such files, one per "
        "LiDAR; recordings with different LiDARs each are one snapshot, recordings of the same LiDARs a snapshot each; "
        "a file may be at s3://, gs:// or https://.",
        show_default=False,
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="[NAME=]/topic",
        help="Take only this topic, as the LiDAR of that name; or a pattern (/lidar_*/points), or a type; repeatable.",
    ),
]
Frames = Annotated[
    int | None,
    typer.Option(
        "--frames",
        metavar="N",
        help="Frames per LiDAR that are accumulated.",
        show_default="10, of a recorded snapshot all",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="S|TIME",
        help="Begin so many seconds after the first frame, or at a time: ISO 8601, seconds or nanoseconds since 1970.",
    ),
]
Window = Annotated[
    Literal["start", "auto"] | None,
    typer.Option("--window", metavar="start|auto", help="auto: where the vehicle stands still for longest."),
]
WindowSeconds = Annotated[
    float | None, typer.Option("--over", metavar="S", help="Spread the frames over so many seconds.")
]
Strict = Annotated[bool, typer.Option("--strict", help="Refuse a recording of which less than all can be used.")]
Preset = Annotated[str | None, typer.Option("--preset", metavar="default|paper", help="Parameters to start from.")]
PriorSource = Annotated[
    str | None,
    typer.Option(
        "--prior",
        metavar="tf|FILE",
        help="Poses to try as well: the recording's /tf_static, or a file, TOML (as calibration.toml) or URDF.",
        show_default=False,
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters as TOML; `multilica config --toml` prints one."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="SECTION.KEY=VALUE", help="One parameter, as in fine.max_iterations=30; repeatable."),
]
Threads = Annotated[
    int | None, typer.Option("--threads", metavar="N", help="Threads; with 1 the same input gives the same bits.")
]
McapEncoding = Annotated[
    Literal["foxglove", "ros2"],
    typer.Option("--mcap-encoding", metavar="foxglove|ros2", help="Encoding of the messages in result.mcap."),
]
Record = Annotated[
    Literal["full", "normal", "slim"] | None,
    typer.Option(
        "--record",
        metavar="full|normal|slim",
        help="How much recording.rrd keeps; as record.detail.",
        show_default="normal",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout, and nothing else there.")]


def mcap_name(out: Path) -> Path:
    """The name itself; a callback of options that name a recording.

    Raises:
        UsageError: it does not end in .mcap.
    """
    if out.suffix != ".mcap":
        raise UsageError(f"Found --out {out}; expected a name that ends in .mcap.")
    return out
