# SPDX-License-Identifier: Apache-2.0
"""`multilica config`: list of all parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from multilica.errors import UsageError
from multilica_cli.options import Parameters, inline_toml, option
from multilica_cli.terminal import print_json, stdout_console

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig

_UNITS = {"_m": "m", "_rad": "rad", "_deg": "deg", "_s": "s", "_ns": "ns", "_hz": "Hz", "_voxels": "voxels"}
_PAGE_HEAD = (
    "<!-- Made by `make docs` from the models in multilica/config: change those. -->",
    "",
    "# Configuration",
    "",
    "Every parameter is defined once, in `multilica/config`. Values come from a preset (`--preset NAME`) or a",
    "TOML file (`--config FILE`; its key `preset` gives the keys that it leaves out), then from options of the command",
    "line, then from `--set section.key=value`. Unknown keys are an error, and so are keys that the chosen engine or",
    "solver does not use. `multilica config` prints the resulting values, `multilica config --toml` prints them as a",
    "file to start from; `result.json` holds those of its run.",
    "",
    "The preset `paper-algorithm1` is `paper` with `merge.mode` `algorithm1`.",
)
_TABLE_HEAD = ("| key | default | `paper`, if different | unit | allowed | meaning |", "|---|---|---|---|---|---|")
_BOUNDS = {"minimum": ">= {}", "exclusiveMinimum": "> {}", "maximum": "<= {}", "exclusiveMaximum": "< {}"}


def config(
    *,
    parameters: Parameters,
    as_json: Annotated[bool, option("--json", "Print JSON.")] = False,
    as_toml: Annotated[bool, option("--toml", "Print a file for --config.")] = False,
    as_markdown: Annotated[bool, option("--markdown", "Print the page docs/reference/configuration.md.")] = False,
) -> None:
    """Print all parameters with value, unit and meaning."""
    if as_json + as_toml + as_markdown > 1:
        raise UsageError("Found more than one of --json, --toml and --markdown; give one of them.")
    resolved = parameters.resolve()
    if as_toml or as_markdown:
        typer.echo(_configuration_file(resolved) if as_toml else configuration_page(), nl=False)
        return
    rows = list_parameters(resolved)
    if as_json:
        print_json([asdict(parameter) for parameter in rows])
        return
    console = stdout_console()
    if console.is_terminal:
        _print_list(rows, resolved.preset, console)
    else:
        console.print(_table(rows, resolved.preset))


def _print_list(rows: Sequence[Parameter], preset: str, console: Console) -> None:
    """Print each parameter with its value, and its meaning below."""
    console.print(f"preset {preset}")
    for _, section in groupby(rows, key=lambda row: row.section):
        console.print()
        for row in section:
            console.print(f"{row.key} = {inline_toml(row.value)} {row.unit}".rstrip())
            console.print(f"    {row.meaning_with_limits}")


def _table(rows: Sequence[Parameter], preset: str) -> Table:
    table = Table(title=f"preset {preset}", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("key", no_wrap=True)
    table.add_column("value", overflow="fold")
    table.add_column("unit")
    table.add_column("meaning", ratio=1)
    for _, section in groupby(rows, key=lambda row: row.section):
        for row in section:
            table.add_row(row.key, inline_toml(row.value), row.unit, row.meaning_with_limits)
        table.add_section()
    return table


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter with its value in TOML; parameters of the whole run have no section."""

    section: str
    name: str
    value: Any
    unit: str
    allowed: str
    meaning: str

    @property
    def key(self) -> str:
        """Return the key that `--set` takes."""
        return f"{self.section}.{self.name}" if self.section else self.name

    @property
    def meaning_with_limits(self) -> str:
        """Return the meaning, followed by the allowed values if they are limited."""
        return self.meaning + (f" ({self.allowed})" if self.allowed else "")


def list_parameters(config: CalibrationConfig) -> tuple[Parameter, ...]:
    """List all parameters with their values, those of the whole run first, then in the order of the stages."""
    values = config.model_dump(mode="json")
    schema = config.model_json_schema()
    found: list[Parameter] = []
    for name, field in schema["properties"].items():
        if "$ref" in field:
            section, held, keys = name, values[name], schema["$defs"][field["$ref"].rpartition("/")[2]]["properties"]
        else:
            section, held, keys = "", values, {name: field}
        for key, each in keys.items():
            unit = _UNITS.get(key[key.rfind("_") :], "")
            found.append(Parameter(section, key, held[key], unit, _allowed(each), each.get("description", "")))
    return tuple(found)


def _allowed(field: dict[str, Any]) -> str:
    if "enum" in field:
        return ", ".join(str(choice) for choice in field["enum"])
    limits = field.get("items", field)
    bounds = [text.format(f"{limits[bound]:g}") for bound, text in _BOUNDS.items() if bound in limits]
    return ("each " if limits is not field and bounds else "") + ", ".join(bounds)


def _configuration_file(config: CalibrationConfig) -> str:
    """Write a file for `--config` with the meaning of each key as a comment."""
    lines = ["# Keys that are left out keep the value of the preset."]
    for section, members in groupby(list_parameters(config), key=lambda parameter: parameter.section):
        lines += ["", f"[{section}]"] if section else []
        for parameter in members:
            lines += [f"# {parameter.meaning_with_limits}", f"{parameter.name} = {inline_toml(parameter.value)}"]
    return "\n".join(lines) + "\n"


def configuration_page() -> str:
    """Write the page of the documentation: one table per section, with the values of `default` and `paper`."""
    from multilica.config import preset

    paper = {parameter.key: parameter.value for parameter in list_parameters(preset("paper"))}
    lines = list(_PAGE_HEAD)
    for section, members in groupby(list_parameters(preset("default")), key=lambda parameter: parameter.section):
        lines += ["", f"## `[{section}]`" if section else "## The whole run", "", *_TABLE_HEAD]
        for each in members:
            other = f"`{inline_toml(paper[each.key])}`" if paper[each.key] != each.value else ""
            cells = (f"`{each.name}`", f"`{inline_toml(each.value)}`", other, each.unit, each.allowed, each.meaning)
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
