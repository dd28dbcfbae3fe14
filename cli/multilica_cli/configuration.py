# SPDX-License-Identifier: Apache-2.0
"""From options of the command line to a configuration."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from multilica.errors import UsageError
from multilica_cli.inline_toml import inline_toml

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig

__all__ = ["ingest_options", "resolve_config", "topic_names"]

_LONGEST_LOG_S = 1e8
"""Three years; more seconds are those since the epoch."""


def resolve_config(
    preset_name: str | None,
    config_file: Path | None,
    options: Mapping[str, object],
    settings: Sequence[str],
    recorded_frames: int | None = None,
) -> CalibrationConfig:
    """The configuration that the user asked for: preset or file, then options, then `--set`.

    Args:
        preset_name: `--preset`; None means ``default``.
        config_file: `--config`.
        options: key of the configuration -> value of its own option; None where it was not given.
        settings: texts of `--set`.
        recorded_frames: frames of a snapshot, all of which are taken unless file or options say otherwise.

    Raises:
        UsageError: a preset and a file, an unknown key or a value out of range.
        SourceNotFoundError: no such file.
    """
    from multilica.config import load_config, preset, with_overrides

    if preset_name and config_file:
        raise UsageError(
            f"Found --preset {preset_name} beside --config {config_file}; give one of them, "
            f'or write preset = "{preset_name}" into the file.'
        )
    config = load_config(config_file) if config_file else preset(preset_name or "default")
    if recorded_frames and not (config_file and _tells_frames(config_file)):
        config = with_overrides(config, [f"ingest.frames={recorded_frames}"])
    given = [f"{key}={inline_toml(value)}" for key, value in options.items() if value is not None]
    return with_overrides(with_overrides(config, given), settings)


def _tells_frames(config_file: Path) -> bool:
    return "frames" in tomllib.loads(config_file.read_text(encoding="utf-8")).get("ingest", {})


def ingest_options(
    topics: Sequence[str] | None,
    frames: int | None,
    start: str | None,
    window: str | None,
    window_s: float | None,
    *,
    strict: bool,
) -> dict[str, object]:
    """The options that say what to read, as `resolve_config` takes them.

    Raises:
        UsageError: a text of `--topic` of another form, or a name twice.
    """
    start_s = _seconds(start)
    return {
        "ingest.topics": topic_names([text for text in topics or () if "=" in text]),
        "ingest.only": [text for text in topics or () if "=" not in text] or None,
        "ingest.frames": frames,
        "ingest.start_s": start_s,
        "ingest.start_at": start if start_s is None else None,
        "ingest.window": window,
        "ingest.window_s": window_s,
        "ingest.strict": strict or None,
    }


def _seconds(start: str | None) -> float | None:
    try:
        seconds = None if start is None else float(start)
    except ValueError:
        return None
    return None if seconds is None or seconds >= _LONGEST_LOG_S else seconds


def topic_names(texts: Sequence[str]) -> dict[str, str] | None:
    """Texts ``NAME=/topic`` as name -> topic; None if there are none.

    Raises:
        UsageError: a text of another form, or a name twice.
    """
    topics: dict[str, str] = {}
    for text in texts:
        name, _, topic = text.partition("=")
        if not name or not topic:
            raise UsageError(
                f"Cannot read --topic '{text}'; expected NAME=/topic, as in --topic front=/lidar_front/points."
            )
        if name in topics:
            raise UsageError(f"Found the name '{name}' in two --topic options; expected one topic per LiDAR.")
        topics[name] = topic
    return topics or None
