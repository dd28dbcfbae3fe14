# SPDX-License-Identifier: Apache-2.0
"""The end of the time for a search, which its registrations check."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_DEADLINE_S: ContextVar[float] = ContextVar("deadline_s", default=math.inf)


class OutOfTime(Exception):  # noqa: N818 - no fault: the search ends
    """The time for the search is over."""


@contextmanager
def time_until(deadline_s: float) -> Iterator[None]:
    """Let `require_time` raise from a time on `time.monotonic` on, which all processes of a machine share."""
    token = _DEADLINE_S.set(deadline_s)
    try:
        yield
    finally:
        _DEADLINE_S.reset(token)


def require_time() -> None:
    """Raise OutOfTime if the time of `time_until` is over; without one, there is always time."""
    deadline_s = _DEADLINE_S.get()
    if deadline_s < math.inf and time.monotonic() > deadline_s:
        raise OutOfTime
