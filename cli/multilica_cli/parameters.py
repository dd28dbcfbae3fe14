# SPDX-License-Identifier: Apache-2.0
"""The configuration as a list of parameters with unit, range and meaning."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from multilica_cli.inline_toml import inline_toml

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig

__all__ = ["Parameter", "configuration_file", "configuration_page", "parameters"]

_UNITS = {"m": "m", "rad": "rad", "deg": "deg", "s": "s", "ns": "ns", "hz": "Hz", "voxels": "voxels"}
_PAGE_HEAD = (
    "<!-- Made by `make docs` from the models in multilica/config.py: change those. -->",
    "",
    "# Configuration",
    "",
    "Every parameter exists once, in `multilica/config.py`. Values come from a preset (`--preset default|paper`) or",
    "a TOML file (`--config FILE`; a key `preset` in it names what the rest comes from), then from options of the",
    "command line, then from `--set section.key=value`. Unknown keys are refused. `multilica config` prints what",
    "results, `multilica config --toml` prints it as a file to start from, `result.json` keeps that of its run.",
)
_TABLE_HEAD = ("| key | default | `paper`, where it differs | unit | allowed | meaning |", "|---|---|---|---|---|---|")
_BOUNDS = {"minimum": ">= {}", "exclusiveMinimum": "> {}", "maximum": "<= {}", "exclusiveMaximum": "< {}"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter.

    Args:
        section: its table, "" for those of the whole run.
        name: its key in that table.
        value: plain value, as TOML holds it.
        unit: "" for numbers without one.
        allowed: range or choices in words, "" if any value of the type will do.
        meaning: what it does.
    """

    section: str
    name: str
    value: Any
    unit: str
    allowed: str
    meaning: str

    @property
    def key(self) -> str:
        """What `--set` takes."""
        return f"{self.section}.{self.name}" if self.section else self.name


def parameters(config: CalibrationConfig) -> tuple[Parameter, ...]:
    """Every parameter with its value in that configuration, in the order of the stages."""
    values = config.model_dump(mode="json")
    schema = config.model_json_schema()
    return tuple(_parameters(schema, schema["$defs"], values))


def _parameters(schema: dict[str, Any], sections: dict[str, Any], values: dict[str, Any]) -> Iterator[Parameter]:
    nested: list[Parameter] = []
    for name, field in schema["properties"].items():
        if "$ref" not in field:
            yield _parameter("", name, field, values[name])
            continue
        section = sections[field["$ref"].rpartition("/")[2]]
        nested += [_parameter(name, key, entry, values[name][key]) for key, entry in section["properties"].items()]
    yield from nested


def _parameter(section: str, name: str, field: dict[str, Any], value: object) -> Parameter:
    unit = _UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""
    return Parameter(section, name, value, unit, _allowed(field), field.get("description", ""))


def _allowed(field: dict[str, Any]) -> str:
    if "enum" in field:
        return ", ".join(str(choice) for choice in field["enum"])
    limits = field.get("items", field)
    bounds = [text.format(f"{limits[bound]:g}") for bound, text in _BOUNDS.items() if bound in limits]
    return ("each " if limits is not field and bounds else "") + ", ".join(bounds)


def configuration_file(config: CalibrationConfig) -> str:
    """A configuration file that says what each key means; `--config` reads it."""
    lines = ["# Keys that are left out keep the value of the preset."]
    section = ""
    for parameter in parameters(config):
        if parameter.section != section:
            section = parameter.section
            lines += ["", f"[{section}]"]
        lines += [f"# {_comment(parameter)}", f"{parameter.name} = {inline_toml(parameter.value)}"]
    return "\n".join(lines) + "\n"


def configuration_page() -> str:
    """The page of the documentation: one table per section, with the values of both presets."""
    from multilica.config import preset

    other = {parameter.key: parameter.value for parameter in parameters(preset("paper"))}
    lines = list(_PAGE_HEAD)
    section: str | None = None
    for parameter in parameters(preset("default")):
        if parameter.section != section:
            section = parameter.section
            lines += ["", f"## `[{section}]`" if section else "## The whole run", "", *_TABLE_HEAD]
        cells = (
            f"`{parameter.name}`",
            f"`{inline_toml(parameter.value)}`",
            f"`{inline_toml(other[parameter.key])}`" if other[parameter.key] != parameter.value else "",
            parameter.unit,
            parameter.allowed,
            parameter.meaning,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _comment(parameter: Parameter) -> str:
    return parameter.meaning + (f" ({parameter.allowed})" if parameter.allowed else "")
