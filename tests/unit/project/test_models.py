# SPDX-License-Identifier: Apache-2.0
"""Pydantic models are values: none can be changed after it was validated."""

from __future__ import annotations

import ast
from pathlib import Path

PRODUCT = Path(__file__).parents[3] / "multilica"


def settings_of(path: Path) -> list[dict[str, object]]:
    calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    models = (call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "ConfigDict")
    return [{each.arg: getattr(each.value, "value", None) for each in model.keywords} for model in models]


def test_models_are_frozen() -> None:
    settings = {path: settings_of(path) for path in PRODUCT.rglob("*.py")}
    assert sum(map(len, settings.values())) >= 8
    assert [path for path, models in settings.items() for model in models if model.get("frozen") is not True] == []
