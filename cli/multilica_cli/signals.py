# SPDX-License-Identifier: Apache-2.0
"""Signals that ask the process to end; imports nothing that takes time, so that they are handled from the start."""

import os
import signal
import sys
import time
from types import FrameType

PREFIX = "multilica: "
"""Start of each line of this program on stderr."""

_NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_GRACE_S = 5.0
_RETRY_S = 0.02
_IMPORTER = "<frozen importlib._bootstrap"

_received: list[int] = []


class Interrupted(BaseException):
    """A signal that asked the process to end."""

    def __init__(self, signal_number: int) -> None:
        self.exit_code = 128 + signal_number
        super().__init__(f"Stopped by {signal.Signals(signal_number).name}.")


def unwind_on_signals() -> None:
    """Raise `Interrupted` in the main thread on SIGINT, SIGTERM and SIGHUP, unless the parent ignores them.

    A signal within an import waits for its end: libraries take an exception there for one of their own. One that the
    interpreter drops, within the clean-up of an object, is raised again. After the first signal, more of them are
    ignored for five seconds, so that they do not disturb the clean-up.
    """
    ignored_until_s = 0.0

    def unwind(number: int, frame: FrameType | None) -> None:
        nonlocal ignored_until_s
        if number != signal.SIGALRM:
            if time.monotonic() < ignored_until_s:
                return
            ignored_until_s = time.monotonic() + _GRACE_S
            _received.append(number)
        if _is_importing(frame):
            signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
            return
        raise Interrupted(_received[-1])

    def raise_again(dropped: "sys.UnraisableHookArgs") -> None:
        if isinstance(dropped.exc_value, Interrupted):
            signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
        else:
            sys.__unraisablehook__(dropped)

    sys.unraisablehook = raise_again
    _received.clear()
    for number in (*_NUMBERS, signal.SIGALRM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, unwind)


def end_on_signals() -> None:
    """End the process at once on these signals: nothing is left to clean up."""

    def end(number: int, frame: FrameType | None) -> None:
        del frame
        os._exit(128 + number)

    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in _NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


def received() -> Interrupted | None:
    """Return the last signal that arrived since `unwind_on_signals`: a library may have caught its exception."""
    return Interrupted(_received[-1]) if _received else None


def print_line(text: str) -> None:
    """Print a line of this program on stderr."""
    sys.stderr.write(f"{PREFIX}{text}\n")


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTER):
            return True
        frame = frame.f_back
    return False
