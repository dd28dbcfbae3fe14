# SPDX-License-Identifier: Apache-2.0
"""Declaration of commands: arguments and options, those that several commands share as types and groups."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial, wraps
from inspect import Parameter
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from multilica.errors import UsageError

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig

_LONGEST_LOG_S = 1e8
"""Three years; larger numbers of --start are seconds since 1970."""


def argument(metavar: str, meaning: str) -> Any:  # noqa: ANN401 - typer's own type is private
    """Declare an argument."""
    return typer.Argument(metavar=metavar, help=meaning, show_default=False)


def option(usage: str, meaning: str, default: str | bool = True, **more: Any) -> Any:  # noqa: ANN401 - typer's own type is private
    """Declare an option by its usage, such as ``--out DIR``; the help may show a text in place of its default."""
    name, _, metavar = usage.partition(" ")
    return typer.Option(name, metavar=metavar or None, help=meaning, show_default=default, **more)


def located(sources: Sequence[str]) -> list[Any]:
    """Return the sources as the library takes them: files that may be remote, and the address of a running vehicle."""
    from multilica.ingest.locate import locate
    from multilica.ingest.remote.address import is_live

    return [source if is_live(source) else locate(source) for source in sources]


def local_path(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Return the path of an option that names an output; refuse an address."""
    if path is None or ":" not in str(path):
        return path
    from multilica.ingest.remote.address import local_output

    return local_output(path, option.opts[0])


def mcap_name(option: typer.CallbackParam, out: Path | None) -> Path | None:
    """Return the path of an option that names an MCAP file to write; refuse an address or another suffix."""
    return _named(option, out, ".mcap")


def png_name(option: typer.CallbackParam, out: Path | None) -> Path | None:
    """Return the path of an option that names a picture to write; refuse an address or another suffix."""
    return _named(option, out, ".png")


def _named(option: typer.CallbackParam, out: Path | None, suffix: str) -> Path | None:
    local_path(option, out)
    if out is not None and out.suffix != suffix:
        raise UsageError(f"Found {option.opts[0]} {out}; expected a name that ends in {suffix}.")
    return out


output = partial(option, callback=local_path)
"""Declare an option that names a file or directory to write."""

RECORDINGS = (
    "MCAP file, ROS 1 or ROS 2 bag, or point files (PCD, PLY, ...) with one file or directory per LiDAR; "
    "local or at s3://, gs:// or https://. Recordings of different LiDARs form one snapshot; recordings of the "
    "same LiDARs, or folders with point files of the same names, form one snapshot each."
)
Sources = Annotated[list[str], argument("SOURCE", RECORDINGS)]
LIVE_SOURCE = "ros2:// for the nodes of a ROS 2 domain, or ws://HOST:PORT of a vehicle that runs foxglove_bridge"
Timeout = Annotated[float | None, option("--timeout S", "Stop listening to a running vehicle after S seconds.", "30")]
Topics = Annotated[
    list[str] | None,
    option(
        "--topic [NAME=]/topic",
        "Topic to use, with a name for its LiDAR; also a pattern (/lidar_*/points) or a message type. Repeatable.",
    ),
]
Frames = Annotated[
    int | None, option("--frames N", "Frames to accumulate per LiDAR.", "10; all frames of a file made by record")
]
ConfigFile = Annotated[
    Path | None, option("--config FILE", "TOML file with parameters; `multilica config --toml` prints one.")
]
Settings = Annotated[
    list[str] | None,
    option("--set SECTION.KEY=VALUE", "Set one parameter, for example fine.max_iterations=30. Repeatable."),
]
Workers = Annotated[
    int | None, option("--workers N", "Worker processes; 1: none. Any number gives the same result.", "one per core")
]
MaxTime = Annotated[
    float | None,
    option("--max-time S", "End all searches after this, then finish with the pairs found; 0: no limit."),
]
Stops = Annotated[
    str | None,
    option(
        "--stops auto|N",
        "Standstills of a log to use, each as a snapshot; auto: up to four that differ in place and see much. "
        "It is 1 if --start, --window or --duration choose the frames.",
        "auto",
    ),
]
WithinM = Annotated[float, option("--within-m M", "Largest position error of a success.")]
WithinDeg = Annotated[float, option("--within-deg DEG", "Largest rotation error of a success.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, option("--json", "Print one JSON document on stdout, and nothing else.")]
FleetStore = Annotated[str, option("--store STORE", "Folder, or s3://BUCKET/PREFIX, of `fleet run`.")]
NEW_RUN_DIRECTORY = "recordings/runs/<source>, or <source>-2, ... if that is taken"


@dataclass(frozen=True, slots=True)
class Reading:
    """The group of options that select which scans are read."""

    topics: Topics = None
    frames: Frames = None
    start: Annotated[
        str | None,
        option(
            "--start S|TIME",
            "Start S seconds after the first frame, or at a time (ISO 8601, or seconds or nanoseconds since 1970).",
        ),
    ] = None
    window: Annotated[
        Literal["start", "auto"] | None,
        option("--window start|auto", "auto: use the longest standstill of the vehicle."),
    ] = None
    window_s: Annotated[float | None, option("--duration S", "Spread the frames over this many seconds.")] = None
    strict: Annotated[bool, option("--strict", "Fail if any part of the recording is unreadable.")] = False

    @property
    def values(self) -> dict[str, object]:
        """The options, as `Parameters.resolve` takes them."""
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

    preset: Annotated[str | None, option("--preset NAME", "Set of parameters: default, paper or paper-algorithm1.")] = (
        None
    )
    config_file: ConfigFile = None
    settings: Settings = None

    def resolve(
        self, options: Mapping[str, object] | None = None, recorded_frames: int | None = None
    ) -> CalibrationConfig:
        """Build the configuration from the preset or file, then options, then `--set`.

        Args:
            options: key of the configuration -> value of its own option; None where it was not given.
            recorded_frames: frames of a file made by `multilica record`; used unless file or options give a number.
        """
        from multilica.config import load_config, preset, read_config_table, with_overrides

        if self.preset and self.config_file:
            raise UsageError(
                f"Found both --preset {self.preset} and --config {self.config_file}; give one of them, "
                f'or write preset = "{self.preset}" into the file.'
            )
        config = load_config(self.config_file) if self.config_file else preset(self.preset or "default")
        table = read_config_table(self.config_file) if self.config_file else {}
        if recorded_frames and "frames" not in table.get("ingest", {}):
            config = with_overrides(config, [f"ingest.frames={recorded_frames}"])
        given = [f"{key}={inline_toml(value)}" for key, value in (options or {}).items() if value is not None]
        return with_overrides(config, [*given, *(self.settings or ())])


def inline_toml(value: object) -> str:
    """Write a scalar, an array or a table as TOML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{inline_toml(key)} = {inline_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(inline_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def sigma_limits(text: str | None) -> dict[str, object]:
    """Return the limits of `--max-sigma MM,DEG`, two numbers above zero, as `Parameters.resolve` takes them."""
    if text is None:
        return {}
    try:
        millimetres, degrees = map(float, text.split(","))
    except ValueError:
        millimetres = degrees = 0.0
    if not (0.0 < millimetres < inf and 0.0 < degrees < inf):
        raise UsageError(
            f"Cannot read --max-sigma '{text}'; expected MM,DEG: two numbers above zero, in millimetres and degrees, "
            "for example --max-sigma 50,0.5."
        )
    return {"acceptance.max_sigma_m": millimetres / 1000.0, "acceptance.max_sigma_deg": degrees}


def stops_value(text: str | None) -> int | str | None:
    """Return the value of `--stops auto|N`, as `Parameters.resolve` takes it."""
    return int(text) if text is not None and text.isdecimal() else text


def topic_names(texts: Sequence[str]) -> dict[str, str] | None:
    """Parse texts ``NAME=/topic``, each with another name, into name -> topic; None if there are none."""
    topics: dict[str, str] = {}
    for text in texts:
        name, _, topic = text.partition("=")
        if not name or not topic:
            raise UsageError(
                f"Cannot read --topic '{text}'; expected NAME=/topic, for example --topic front=/lidar_front/points."
            )
        if name in topics:
            raise UsageError(f"Found the name '{name}' in two --topic options; expected one topic per LiDAR.")
        topics[name] = topic
    return topics or None


class _PlainHelp:
    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - a private type of typer
        """Return the parameters, without types of flags, which take no value, and of arguments, which are described."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
            elif param.param_type_name == "argument":
                param.display_type_rich = lambda **_: None
        return params


class _Command(_PlainHelp, TyperCommand):
    pass


class _Group(_PlainHelp, TyperGroup):
    pass


class App(typer.Typer):
    """A command line, or a group of commands within one."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of typer
        super().__init__(cls=_Group, **options)

    def command(self, *names: Any, **options: Any) -> Callable[[Any], Any]:  # noqa: ANN401 - those of typer
        """Register a function as a command; a parameter that is a dataclass stands for an option per field."""
        register = super().command(*names, cls=_Command, **options)
        return lambda function: register(_with_groups(function))


def _with_groups(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with the fields of its parameters that are dataclasses as parameters of their own."""
    signature = inspect.signature(function, eval_str=True)
    every = signature.parameters.items()
    groups: dict[str, Any] = {name: each.annotation for name, each in every if is_dataclass(each.annotation)}
    if not groups:
        return function

    @wraps(function)
    def with_fields(**values: Any) -> Any:  # noqa: ANN401 - those of the function
        for name, group in groups.items():
            values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
        return function(**values)

    parameters: list[Parameter] = []
    for name, each in every:
        parameters += _fields_of(groups[name]) if name in groups else [each]
    with_fields.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return with_fields


def _fields_of(group: Any) -> list[Parameter]:  # noqa: ANN401 - a type of dataclass
    hints = get_type_hints(group, include_extras=True)
    defaults = (Parameter.empty if each.default is MISSING else each.default for each in fields(group))
    return [
        Parameter(each.name, Parameter.KEYWORD_ONLY, default=default, annotation=hints[each.name])
        for each, default in zip(fields(group), defaults, strict=True)
    ]
