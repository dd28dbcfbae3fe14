# SPDX-License-Identifier: Apache-2.0
"""Options of the command line as a configuration."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from multilica.errors import UsageError

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig


def resolve_config(
    preset_name: str | None,
    config_file: Path | None,
    options: Mapping[str, object],
    settings: Sequence[str],
    recorded_frames: int | None = None,
) -> CalibrationConfig:
    """Build the configuration from the preset or file, then options, then `--set`.

    Args:
        options: key of the configuration -> value of its own option; None where it was not given.
        recorded_frames: frames of a file made by `multilica record`; used unless file or options give a number.

    Raises:
        UsageError: a preset and a file, an unknown key or a value out of range.
        SourceNotFoundError: no such file.
    """
    from multilica.config import load_config, preset, read_config_table, with_overrides

    if preset_name and config_file:
        raise UsageError(
            f"Found both --preset {preset_name} and --config {config_file}; give one of them, "
            f'or write preset = "{preset_name}" into the file.'
        )
    config = load_config(config_file) if config_file else preset(preset_name or "default")
    table = read_config_table(config_file) if config_file else {}
    if recorded_frames and "frames" not in table.get("ingest", {}):
        config = with_overrides(config, [f"ingest.frames={recorded_frames}"])
    given = [f"{key}={inline_toml(value)}" for key, value in options.items() if value is not None]
    return with_overrides(config, [*given, *settings])


def inline_toml(value: object) -> str:
    """Write a scalar, an array or a table as TOML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{inline_toml(key)} = {inline_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(inline_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def sigma_limits(text: str | None) -> dict[str, object]:
    """Return the limits of `--max-sigma MM,DEG`, as `resolve_config` takes them.

    Raises:
        UsageError: not two numbers above zero.
    """
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


def topic_names(texts: Sequence[str]) -> dict[str, str] | None:
    """Parse texts ``NAME=/topic`` into name -> topic; None if there are none.

    Raises:
        UsageError: a text in another form, or a name twice.
    """
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
