# SPDX-License-Identifier: Apache-2.0
"""Events passed on in a thread, so that sinks write while worker processes compute."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from threading import Event as Signal
from threading import Thread

from multilica.events import Event, Observer

# A signal that comes just before a wait does not wake it: its handler runs when the wait ends.
_SIGNAL_CHECK_S = 0.2


@contextmanager
def pass_aside(observe: Observer) -> Iterator[Observer]:
    """Pass events to an observer in a thread, in their order; all are passed when the context ends.

    An error of the observer is raised by the next call or at the end, and no event follows. A signal that interrupts
    the wait for the last events drops those that are not begun; the one that is begun is passed completely.
    """
    aside = _Aside(observe)
    thread = Thread(target=aside.run, name="sinks", daemon=True)
    thread.start()
    try:
        yield aside
    finally:
        try:
            aside.end()
        except BaseException:
            aside.drop()
            aside.end()
            raise
    thread.join()
    aside.raise_failure()


class _Aside:
    def __init__(self, observe: Observer) -> None:
        self._observe = observe
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._failure: BaseException | None = None
        self._ended = Signal()

    def __call__(self, event: Event) -> None:
        self.raise_failure()
        self._events.put(event)

    def run(self) -> None:
        """Pass events on until `end`."""
        try:
            while (event := self._events.get()) is not None:
                self._observe(event)
        except BaseException as failure:  # noqa: BLE001 - the caller's thread raises it
            self._failure = failure
        finally:
            self._ended.set()

    def end(self) -> None:
        """Wait until all events are passed: an interrupted `Thread.join` takes the thread for ended."""
        self._events.put(None)
        while not self._ended.wait(_SIGNAL_CHECK_S):
            pass

    def drop(self) -> None:
        with suppress(Empty):
            while True:
                self._events.get_nowait()

    def raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure
