# SPDX-License-Identifier: Apache-2.0
import os
import signal
import threading
import time

import pytest

from multilica.sinks.aside import pass_aside


def test_events_are_passed_in_order_by_one_other_thread():
    seen = []
    with pass_aside(lambda event: seen.append((event, threading.current_thread()))) as observe:
        for event in range(100):
            observe(event)
    assert [event for event, _ in seen] == list(range(100))
    (thread,) = {thread for _, thread in seen}
    assert thread is not threading.current_thread()
    assert not thread.is_alive()


def test_the_caller_does_not_wait():
    go, seen = threading.Event(), []

    def wait(event):
        go.wait(10.0)
        seen.append(event)

    with pass_aside(wait) as observe:
        observe(1)
        observe(2)
        assert seen == []
        go.set()
    assert seen == [1, 2]


def test_a_failure_reaches_the_caller_and_ends_the_events():
    seen, failed = [], threading.Event()

    def fail(event):
        seen.append(event)
        failed.set()
        raise OSError(28, "No space left on device")

    def run():
        with pass_aside(fail) as observe:
            observe(1)
            failed.wait(10.0)
            while True:
                observe(2)

    with pytest.raises(OSError, match="No space"):
        run()
    assert seen == [1]


def test_a_failure_of_the_last_event_is_raised_at_the_end():
    def fail(_):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"), pass_aside(fail) as observe:
        observe(1)


def test_an_exception_of_the_caller_comes_after_the_events():
    seen = []

    def stop():
        with pass_aside(seen.append) as observe:
            observe(1)
            raise KeyError

    with pytest.raises(KeyError):
        stop()
    assert seen == [1]


def test_a_signal_during_the_wait_comes_after_the_event():
    queues, seen = [], []

    def until(is_so):
        end_s = time.monotonic() + 10.0
        while not is_so() and time.monotonic() < end_s:
            time.sleep(0.001)

    def work(event):
        until(lambda: queues and queues[0].qsize() == 2)  # the other event, and the end: the caller waits
        os.kill(os.getpid(), signal.SIGUSR1)
        until(lambda: queues[0].qsize() < 2)
        seen.append(event)

    def interrupt(*_):
        raise InterruptedError

    def run():
        with pass_aside(work) as observe:
            queues.append(observe._events)
            observe(1)
            observe(2)

    before = signal.signal(signal.SIGUSR1, interrupt)
    try:
        with pytest.raises(InterruptedError):
            run()
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert seen == [1]
