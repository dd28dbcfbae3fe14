# SPDX-License-Identifier: Apache-2.0
"""Times of logs in UTC."""

from datetime import UTC, datetime


def moment(time_ns: int) -> datetime:
    """Return nanoseconds since the epoch as a time, to the microsecond."""
    return datetime.fromtimestamp(time_ns // 10**9, UTC).replace(microsecond=time_ns % 10**9 // 1000)


def day_of(time_ns: int) -> str:
    """Return the day of a time, such as ``2026-03-01``."""
    return f"{moment(time_ns):%Y-%m-%d}"


def month_of(time_ns: int | None) -> str:
    """Return the month of a time, such as ``2026-03``; ``unknown`` without a time."""
    return "unknown" if time_ns is None else f"{moment(time_ns):%Y-%m}"
