# SPDX-License-Identifier: Apache-2.0
"""Keys that only some engines and solvers use."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from multilica.config.calibration import CalibrationConfig
from multilica.errors import ConfigError

_TEASER = ("maximum_clique", "teaserpp")
_USED_WITH: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "fine.rotation_epsilon_rad": ("fine.engine", ("small_gicp",)),
    "fine.translation_epsilon_m": ("fine.engine", ("small_gicp",)),
    "fine.gicp_epsilon": ("fine.engine", ("open3d",)),
    "fine.relative_fitness": ("fine.engine", ("open3d",)),
    "fine.relative_rmse": ("fine.engine", ("open3d",)),
    "coarse.cbar2": ("coarse.solver", _TEASER),
    "coarse.gnc_factor": ("coarse.solver", _TEASER),
    "coarse.gnc_max_iterations": ("coarse.solver", _TEASER),
    "coarse.gnc_cost_threshold": ("coarse.solver", _TEASER),
    "coarse.max_hypotheses": ("coarse.solver", ("cliques",)),
}
"""Per key the key that chooses who uses it, and the choices that do."""


def refuse_unused(config: CalibrationConfig, keys: Iterable[str], where: str) -> None:
    """Refuse keys that someone set and that the chosen engine or solver does not use.

    Args:
        keys: as ``section.key``.
        where: what set them, for the message.

    Raises:
        ConfigError: there is one.
    """
    values = config.model_dump()
    for key in keys:
        chooser, users = _USED_WITH.get(key, ("", ()))
        if not chooser:
            continue
        section, _, name = chooser.partition(".")
        chosen = values[section][name]
        if chosen not in users:
            raise ConfigError(
                f"In {where}, {key} has no effect with {chooser}={chosen}; "
                f"leave it out, or set {chooser}={' or '.join(users)}."
            )


def leaf_keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield each key of a nested table as ``section.key``, with its value."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from leaf_keys(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
