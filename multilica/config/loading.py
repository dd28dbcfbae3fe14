# SPDX-License-Identifier: Apache-2.0
"""Configurations from presets, TOML files and single settings."""

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from multilica.config.sections import CalibrationConfig, Section
from multilica.documents import MAX_TOML_BYTES, DocumentError, first_problem, parse_toml, read_limited, shown
from multilica.errors import ConfigError, UnknownNameError

_PAPER: Mapping[str, Any] = {
    "stillness": {"enabled": False},
    "preprocess": {"min_range_m": 0.0, "max_range_m": 1e6, "voxel_size_m": 0.0},
    "features": {
        "engine": "open3d",
        "voxel_size_m": 0.35,
        "normal_radius_voxels": 5.0,
        "normal_neighbours": 100,
        "feature_radius_voxels": 5.0,
        "feature_neighbours": 100,
        "max_range_m": 25.0,
        "range_shape": "box",
        "orient_normals": False,
    },
    "correspond": {"engine": "kd_tree", "max_keypoints": 0, "max_matches": 0},
    "coarse": {
        "solver": "teaserpp",
        "noise_bound_m": 0.35,
        "max_hypotheses": 1,
        "normal_tolerance_deg": 180.0,
        "min_agreeing_matches": 0,
    },
    "verify": {"enabled": False},
    "acceptance": {"max_baseline_m": 1e6},
    "fine": {
        "engine": "open3d",
        "voxel_size_m": 0.05,
        "max_points": 1_000_000_000,
        "max_correspondence_distances_m": [1.0],
        "max_iterations": 100,
        "neighbours": 30,
        "fitness_distance_m": 1.0,
    },
    "refine": {"enabled": False},
}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {"preset": "default"},
    "paper": {**_PAPER, "preset": "paper", "merge": {"mode": "target_first", "fitness_threshold": 0.2}},
    "paper-algorithm1": {
        **_PAPER,
        "preset": "paper-algorithm1",
        "merge": {"mode": "algorithm1", "fitness_threshold": 0.2},
    },
}

_USED_WITH: Mapping[str, tuple[str, str]] = {
    "fine.rotation_epsilon_rad": ("fine.engine", "small_gicp"),
    "fine.translation_epsilon_m": ("fine.engine", "small_gicp"),
    "coarse.max_hypotheses": ("coarse.solver", "cliques"),
}
"""Keys that only one engine or solver uses, with the key that chooses it and the choice."""


def preset(name: str) -> CalibrationConfig:
    """Return the configuration of a preset.

    Raises:
        UnknownNameError: no such preset.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return CalibrationConfig.model_validate(PRESETS[name])


def load_config(path: Path | str) -> CalibrationConfig:
    """Read a TOML file; missing keys come from the preset that it names, else from `default`.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, a value out of range, or a key that differs from the
            preset and has no effect.
        UnknownNameError: no such preset.
    """
    table = read_config_table(Path(path))
    base = preset(str(table.get("preset", "default")))
    config = _merged(base, table, str(path))
    # A file that `multilica config --toml` wrote has every key.
    _refuse_unused(config, {key: str(path) for key in _USED_WITH if _value(config, key) != _value(base, key)})
    require_ranges(config, f"In {path}, ")
    return config


def read_config_table(path: Path) -> dict[str, Any]:
    """Read the table in a TOML file as it stands there, without a check of its keys.

    Raises:
        ConfigError: no such file, or not TOML.
    """
    try:
        return parse_toml(read_limited(path, MAX_TOML_BYTES))
    except FileNotFoundError as error:
        raise ConfigError(f"There is no configuration file at {path}.") from error
    except (OSError, DocumentError) as error:
        raise ConfigError(f"{path} is not a readable TOML file: {error}.") from error


def with_overrides(config: CalibrationConfig, overrides: Iterable[str]) -> CalibrationConfig:
    """Apply ``section.key=value`` settings; a value is read as TOML, else as a bare string.

    Raises:
        ConfigError: a text without ``=``, an unknown key, a value out of range, or a key without effect.
    """
    given: dict[str, str] = {}
    for override in overrides:
        key, equals, text = override.partition("=")
        keys = key.strip().split(".")
        if not equals or not key.strip() or len(keys) > 16:
            raise ConfigError(
                f"Cannot read the setting '{override}'; expected section.key=value, as in fine.max_iterations=30."
            )
        if keys == ["preset"]:
            raise ConfigError(
                f"The setting '{override}' changes the name of the preset, not its values; choose one with --preset, "
                "in Python with preset()."
            )
        table: Any = _toml_value(key, text.strip())
        for part in reversed(keys):
            table = {part: table}
        config = _merged(config, table, f"setting '{override}'")
        given |= {known: f"setting '{override}'" for known in _USED_WITH if _has(table, known)}
    _refuse_unused(config, given)
    require_ranges(config)
    return config


def require_ranges(config: CalibrationConfig, where: str = "") -> None:
    """Raise ConfigError if no return can lie between the range limits; `where` begins the sentence.

    Sections cannot check it: settings are applied one after the other.
    """
    limits = config.preprocess
    if limits.min_range_m >= limits.max_range_m:
        raise ConfigError(
            f"{where}preprocess.min_range_m is {limits.min_range_m:g} and preprocess.max_range_m "
            f"{limits.max_range_m:g}: no return lies between; set the first to less than the second."
        )


def _refuse_unused(config: CalibrationConfig, given: Mapping[str, str]) -> None:
    """Refuse keys that the chosen engine or solver does not use; `given` tells what set them."""
    for key, where in given.items():
        chooser, user = _USED_WITH[key]
        if (chosen := _value(config, chooser)) != user:
            raise ConfigError(
                f"In {where}, {key} has no effect with {chooser}={chosen}; leave it out, or set {chooser}={user}."
            )


def _value(config: CalibrationConfig, key: str) -> object:
    section, _, name = key.partition(".")
    return getattr(getattr(config, section), name)


def _has(table: Mapping[str, Any], key: str) -> bool:
    section, _, name = key.partition(".")
    return isinstance(values := table.get(section), Mapping) and name in values


def _toml_value(key: str, text: str) -> object:
    try:
        return parse_toml(f"value = {text}")["value"]
    except DocumentError as error:
        if isinstance(error.__cause__, tomllib.TOMLDecodeError):
            return text
        raise ConfigError(f"Cannot read the setting '{key}': {error}.") from error


def _merged(base: CalibrationConfig, table: Mapping[str, Any], where: str) -> CalibrationConfig:
    try:
        return CalibrationConfig.model_validate(_deep_update(base.model_dump(), table))
    except ValidationError as error:
        key, what, found = first_problem(error)
        if error.errors(include_url=False, include_context=False)[0]["type"] != "extra_forbidden":
            raise ConfigError(f"In {where}, {key} is {shown(found)}: {what}.") from error
        close = _nearest_key(key)
        hint = f" Did you mean '{close}'?" if close else " `multilica config` lists them all."
        raise ConfigError(f"In {where}, there is no key '{key}'.{hint}") from error


def _deep_update(base: dict[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    updated = dict(base)
    for key, value in table.items():
        current = updated.get(key)
        updated[key] = (
            _deep_update(current, value) if isinstance(current, dict) and isinstance(value, Mapping) else value
        )
    return updated


def _nearest_key(key: str) -> str:
    keys = known_keys()
    leaves = {known.rpartition(".")[2]: known for known in keys}
    by_path = difflib.get_close_matches(key, keys, n=1, cutoff=0.6)
    by_leaf = difflib.get_close_matches(key.rpartition(".")[2], leaves, n=1, cutoff=0.6)
    return by_path[0] if by_path else leaves[by_leaf[0]] if by_leaf else ""


def known_keys() -> tuple[str, ...]:
    """List every key of the configuration as ``section.key``."""
    keys: list[str] = []
    for name, field in CalibrationConfig.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, Section):
            keys += [f"{name}.{key}" for key in section.model_fields]
        else:
            keys.append(name)
    return tuple(keys)
