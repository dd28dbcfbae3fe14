# SPDX-License-Identifier: Apache-2.0
"""Signals as exceptions, so that open files are put in order before the process ends."""

from __future__ import annotations

import signal
import time
from types import FrameType

__all__ = ["Interrupted", "unwind_on_signals"]

_GRACE_S = 5.0


class Interrupted(BaseException):
    """A signal asked the process to end.

    Args:
        signal_number: the signal, for instance ``signal.SIGTERM``.
    """

    def __init__(self, signal_number: int) -> None:
        self.signal_number = signal_number
        super().__init__(f"Stopped by {signal.Signals(signal_number).name}.")

    @property
    def exit_code(self) -> int:
        """What a shell reports for a process that this signal ended."""
        return 128 + self.signal_number


def unwind_on_signals() -> None:
    """Raise `Interrupted` in the main thread on SIGINT, SIGTERM and SIGHUP, unless the parent has them ignored."""
    handler = _Unwinder()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


class _Unwinder:
    """Raises once, then leaves the clean-up some seconds of peace from an impatient second signal."""

    def __init__(self) -> None:
        self._quiet_until_s = 0.0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        del frame
        if time.monotonic() >= self._quiet_until_s:
            self._quiet_until_s = time.monotonic() + _GRACE_S
            raise Interrupted(number)
