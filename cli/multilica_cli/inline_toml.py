# SPDX-License-Identifier: Apache-2.0
"""Values as TOML on one line."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

__all__ = ["inline_toml"]


def inline_toml(value: object) -> str:
    """A scalar, an array or a table, as it stands right of the equals sign."""
    if isinstance(value, Mapping):
        items = (f"{inline_toml(key)} = {inline_toml(item)}" for key, item in value.items())
        return "{" + ", ".join(items) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(inline_toml(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)
