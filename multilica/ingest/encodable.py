# SPDX-License-Identifier: Apache-2.0
"""Texts that files of any kind take."""

from __future__ import annotations

__all__ = ["encodable"]


def encodable(value: object) -> str:
    """The value as text; half a surrogate pair, which JSON and names of files can hold, becomes a question mark."""
    return str(value).encode("utf-8", "replace").decode("utf-8")
