# SPDX-License-Identifier: Apache-2.0
"""Signals as exceptions, so that open files are closed before the process ends."""

import signal
import time
from types import FrameType

__all__ = ["Interrupted", "unwind_on_signals"]

_GRACE_S = 5.0


class Interrupted(BaseException):
    """A signal that asked the process to end.

    Args:
        signal_number: for instance ``signal.SIGTERM``.
    """

    def __init__(self, signal_number: int) -> None:
        self.exit_code = 128 + signal_number
        super().__init__(f"Stopped by {signal.Signals(signal_number).name}.")


def unwind_on_signals() -> None:
    """Raise `Interrupted` in the main thread on SIGINT, SIGTERM and SIGHUP, unless the parent ignores them.

    After the first signal, more of them are ignored for five seconds, so that they do not disturb the clean-up.
    """
    ignored_until_s = 0.0

    def unwind(number: int, frame: FrameType | None) -> None:
        nonlocal ignored_until_s
        del frame
        if time.monotonic() >= ignored_until_s:
            ignored_until_s = time.monotonic() + _GRACE_S
            raise Interrupted(number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, unwind)
