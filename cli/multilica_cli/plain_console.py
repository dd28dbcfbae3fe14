# SPDX-License-Identifier: Apache-2.0
"""A console that shows the control characters of names instead of obeying them."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from multilica_cli.terminal import printable

__all__ = ["PlainConsole"]


class PlainConsole(Console):
    """As rich's; every text that is not styled yet, also in cells of tables, passes through `printable`."""

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401 - those of rich
        """As of rich's console."""
        return super().render_str(printable(text), **options)
