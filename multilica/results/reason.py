# SPDX-License-Identifier: Apache-2.0
"""Why something was not believed."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Reason"]


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a registration was not accepted, or a sensor not trusted, as data.

    Args:
        code: stable name, for programs.
        value, limit: the figure and what it was held against.
        text: the same for people.
    """

    code: str
    value: float
    limit: float
    text: str
