# SPDX-License-Identifier: Apache-2.0
"""Single messages at times spread over a recording."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing

from multilica.ingest.recording import RawMessage, Recording

PATIENCE_NS = 10 * 10**9
"""Drivers that start one after the other have started by then; later, the vehicle may be somewhere else."""
_MIN_JUMP_NS = 2 * 10**9
"""Nearer messages lie in the same or the next chunk, where reading on is as fast as a jump."""


def evenly(start_ns: int, end_ns: int, count: int) -> list[int]:
    """Return the beginnings of `count` equal parts of a time range."""
    return [start_ns + (end_ns - start_ns) * index // count for index in range(count)]


def sampled(
    recording: Recording,
    topics: Collection[str],
    times_ns: Sequence[int],
    end_ns: int,
    most: int = 1,
    jump_ns: int = _MIN_JUMP_NS,
) -> Iterator[tuple[int, RawMessage]]:
    """Yield the index of each time and, per topic, the first messages from then on and before the next time.

    In an indexed recording, wait `PATIENCE_NS` for a silent topic rather than until the next time.

    Args:
        times_ns: log times, ascending; `end_ns` is the end of the last one's messages, exclusive.
        most: messages per time and topic.
        jump_ns: if the times are farther apart than this, skip what lies between.
    """
    if recording.is_indexed and len(times_ns) > 1 and times_ns[1] - times_ns[0] > jump_ns:
        for index, (start_ns, until_ns) in enumerate(zip(times_ns, [*times_ns[1:], end_ns], strict=True)):
            for _, message in sampled(recording, topics, [start_ns], min(until_ns, start_ns + PATIENCE_NS), most):
                yield index, message
        return
    taken: Counter[tuple[int, str]] = Counter()
    with closing(recording.messages(topics, times_ns[0])) as messages:
        for message in messages:
            if message.log_time_ns >= end_ns:
                return
            index = bisect_right(times_ns, message.log_time_ns) - 1
            taken[index, message.topic] += 1
            if taken[index, message.topic] <= most:
                yield index, message
            if index == len(times_ns) - 1 and all(taken[index, topic] >= most for topic in topics):
                return
