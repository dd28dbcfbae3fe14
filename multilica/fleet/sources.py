# SPDX-License-Identifier: Apache-2.0
"""The names of logs in tables."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ListedLog:
    """A log before its content is read; `vehicle` and `time_ns` if a manifest gives them.

    Args:
        address: path or address that it is read from.
        source: its name in tables.
        path: absolute, without links in the folder that was given; empty at an address.
    """

    address: str
    source: str
    path: str = ""
    vehicle: str = ""
    time_ns: int | None = None
