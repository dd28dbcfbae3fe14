# SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from multilica.errors import UsageError

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="SOURCE",
        help="MCAP file, ROS 1 or ROS 2 bag, or point files (PCD, PLY, ...) with one file or directory per LiDAR; "
        "local or at s3://, gs:// or https://. Recordings of different LiDARs form one snapshot; recordings of the "
        "same LiDARs form one snapshot each.",
        show_default=False,
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="[NAME=]/topic",
        help="Topic to use, with a name for its LiDAR; also a pattern (/lidar_*/points) or a message type. Repeatable.",
    ),
]
Frames = Annotated[
    int | None,
    typer.Option(
        "--frames", metavar="N", help="Frames to accumulate per LiDAR.", show_default="10; all of a file made by record"
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="S|TIME",
        help="Start S seconds after the first frame, or at a time (ISO 8601, or seconds or nanoseconds since 1970).",
    ),
]
Window = Annotated[
    Literal["start", "auto"] | None,
    typer.Option("--window", metavar="start|auto", help="auto: use the longest standstill of the vehicle."),
]
WindowSeconds = Annotated[
    float | None, typer.Option("--duration", metavar="S", help="Spread the frames over this many seconds.")
]
Strict = Annotated[bool, typer.Option("--strict", help="Fail if any part of the recording is unreadable.")]
Preset = Annotated[
    str | None, typer.Option("--preset", metavar="NAME", help="Set of parameters: default, paper or paper-algorithm1.")
]
PriorSource = Annotated[
    str | None,
    typer.Option(
        "--prior",
        metavar="tf|FILE",
        help="Known poses to try as well: tf (the recording's /tf_static), or a TOML, URDF or other file of poses.",
        show_default=False,
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="TOML file with parameters; `multilica config --toml` prints one."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="SECTION.KEY=VALUE", help="Set one parameter, for example fine.max_iterations=30. Repeatable."
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        help="Worker processes; 1: none. Results are the same bits with any number.",
        show_default="one per core",
    ),
]
MaxSigma = Annotated[
    str | None,
    typer.Option(
        "--max-sigma",
        metavar="MM,DEG",
        help="Largest standard deviations of a placed LiDAR; above one of them it is uncertain.",
        show_default="20,0.2",
    ),
]
McapEncoding = Annotated[
    Literal["foxglove", "ros2"],
    typer.Option("--mcap-encoding", metavar="foxglove|ros2", help="Message encoding of result.mcap."),
]
Record = Annotated[
    Literal["full", "normal", "slim"] | None,
    typer.Option(
        "--record", metavar="full|normal|slim", help="Level of detail of recording.rrd.", show_default="normal"
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout, and nothing else.")]

FleetStore = Annotated[
    str,
    typer.Option("--store", metavar="STORE", help="Folder, or s3://BUCKET/PREFIX, of `fleet run`.", show_default=False),
]


def local_path(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Return the path of an option that names an output.

    Raises:
        UsageError: it is an address.
    """
    if path is None or ":" not in str(path):
        return path
    from multilica.ingest.remote.address import local_output

    return local_output(path, option.opts[0])


def mcap_name(option: typer.CallbackParam, out: Path | None) -> Path | None:
    """Return the path of an option that names an MCAP file to write.

    Raises:
        UsageError: it is an address, or does not end in .mcap.
    """
    local_path(option, out)
    if out is not None and out.suffix != ".mcap":
        raise UsageError(f"Found --out {out}; expected a name that ends in .mcap.")
    return out
