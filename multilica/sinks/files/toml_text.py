# SPDX-License-Identifier: Apache-2.0
"""Readable TOML."""

import re
from collections.abc import Mapping
from typing import Any

import tomli_w

__all__ = ["toml_text"]

_NUMBERS = re.compile(r"\[\n([-+\d.eE,\s]+?),?\s*\]")


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML with each row of numbers on one line."""
    return _NUMBERS.sub(lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]", tomli_w.dumps(document))
