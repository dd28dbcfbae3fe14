# SPDX-License-Identifier: Apache-2.0
"""Arguments and options, those that several commands share as types and groups."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from multilica.errors import UsageError
from multilica_cli.configuration import resolve_config, topic_names

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig

_LONGEST_LOG_S = 1e8
"""Three years; larger numbers of --start are seconds since 1970."""


def argument(metavar: str, meaning: str) -> Any:  # noqa: ANN401 - typer's own type is private
    """Declare an argument."""
    return typer.Argument(metavar=metavar, help=meaning, show_default=False)


def option(usage: str, meaning: str, **more: Any) -> Any:  # noqa: ANN401 - typer's own type is private
    """Declare an option.

    Args:
        usage: its name, then its value as the help shows it, such as ``--out DIR``; a flag has no value.
        more: as `typer.Option` takes it.
    """
    name, _, metavar = usage.partition(" ")
    return typer.Option(name, metavar=metavar or None, help=meaning, **more)


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


output = partial(option, callback=local_path)
"""Declare an option that names a file or directory to write."""

Sources = Annotated[
    list[str],
    argument(
        "SOURCE",
        "MCAP file, ROS 1 or ROS 2 bag, or point files (PCD, PLY, ...) with one file or directory per LiDAR; "
        "local or at s3://, gs:// or https://. Recordings of different LiDARs form one snapshot; recordings of the "
        "same LiDARs form one snapshot each.",
    ),
]
Topics = Annotated[
    list[str] | None,
    option(
        "--topic [NAME=]/topic",
        "Topic to use, with a name for its LiDAR; also a pattern (/lidar_*/points) or a message type. Repeatable.",
    ),
]
Frames = Annotated[
    int | None,
    option("--frames N", "Frames to accumulate per LiDAR.", show_default="10; all frames of a file made by record"),
]
Start = Annotated[
    str | None,
    option(
        "--start S|TIME",
        "Start S seconds after the first frame, or at a time (ISO 8601, or seconds or nanoseconds since 1970).",
    ),
]
Window = Annotated[
    Literal["start", "auto"] | None, option("--window start|auto", "auto: use the longest standstill of the vehicle.")
]
Preset = Annotated[str | None, option("--preset NAME", "Set of parameters: default, paper or paper-algorithm1.")]
ConfigFile = Annotated[
    Path | None, option("--config FILE", "TOML file with parameters; `multilica config --toml` prints one.")
]
Settings = Annotated[
    list[str] | None,
    option("--set SECTION.KEY=VALUE", "Set one parameter, for example fine.max_iterations=30. Repeatable."),
]
Workers = Annotated[
    int | None,
    option(
        "--workers N",
        "Worker processes; 1: none. Any number gives the same result.",
        show_default="one per core",
    ),
]
WithinM = Annotated[float, option("--within-m M", "Largest position error of a success.")]
WithinDeg = Annotated[float, option("--within-deg DEG", "Largest rotation error of a success.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, option("--json", "Print one JSON document on stdout, and nothing else.")]
FleetStore = Annotated[
    str, option("--store STORE", "Folder, or s3://BUCKET/PREFIX, of `fleet run`.", show_default=False)
]
NEW_RUN_DIRECTORY = "recordings/runs/<source>, or <source>-2, ... if that is taken"


@dataclass(frozen=True, slots=True)
class Reading:
    """The group of options that select which scans are read."""

    topics: Topics = None
    frames: Frames = None
    start: Start = None
    window: Window = None
    window_s: Annotated[float | None, option("--duration S", "Spread the frames over this many seconds.")] = None
    strict: Annotated[bool, option("--strict", "Fail if any part of the recording is unreadable.")] = False

    @property
    def values(self) -> dict[str, object]:
        """The options, as `resolve_config` takes them.

        Raises:
            UsageError: a text of `--topic` in another form, or a name twice.
        """
        try:
            start_s = None if self.start is None else float(self.start)
        except ValueError:
            start_s = None
        if start_s is not None and start_s >= _LONGEST_LOG_S:
            start_s = None
        return {
            "ingest.topics": topic_names([text for text in self.topics or () if "=" in text]),
            "ingest.only": [text for text in self.topics or () if "=" not in text] or None,
            "ingest.frames": self.frames,
            "ingest.start_s": start_s,
            "ingest.start_at": self.start if start_s is None else None,
            "ingest.window": self.window,
            "ingest.window_s": self.window_s,
            "ingest.strict": self.strict or None,
        }


@dataclass(frozen=True, slots=True)
class Parameters:
    """The group of options that set parameters."""

    preset: Preset = None
    config_file: ConfigFile = None
    settings: Settings = None

    def resolve(
        self, options: dict[str, object] | None = None, recorded_frames: int | None = None
    ) -> CalibrationConfig:
        """Build the configuration; see `resolve_config`."""
        return resolve_config(self.preset, self.config_file, options or {}, self.settings or (), recorded_frames)
