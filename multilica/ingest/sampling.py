# SPDX-License-Identifier: Apache-2.0
"""Some messages of a long recording, without reading all of it."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing

from multilica.ingest.recording import Message, Recording

__all__ = ["PATIENCE_NS", "evenly", "sampled"]

PATIENCE_NS = 10 * 10**9
"""Drivers that start one after the other have started by then; later, the vehicle may be somewhere else."""

_WORTH_A_JUMP_NS = 2 * 10**9
"""Nearer messages lie in the same chunks or the next ones, and are as soon read as looked up."""


def evenly(start_ns: int, end_ns: int, count: int) -> list[int]:
    """The beginnings of `count` equal parts of a stretch of time."""
    return [start_ns + (end_ns - start_ns) * index // count for index in range(count)]


def sampled(
    recording: Recording,
    topics: Collection[str],
    times_ns: Sequence[int],
    end_ns: int,
    most: int = 1,
    jump_ns: int = _WORTH_A_JUMP_NS,
) -> Iterator[tuple[int, Message]]:
    """For each time and each topic, the first messages that were logged from then on, before the next time.

    Of an indexed recording, a topic that is silent is waited for over `PATIENCE_NS`, not to the next time.

    Args:
        times_ns: ascending.
        end_ns: what was logged then or later is left out.
        most: messages per time and topic.
        jump_ns: where the times lie farther apart than this, what lies between them is not read.

    Yields:
        Index of the time, message.
    """
    if recording.is_indexed and len(times_ns) > 1 and times_ns[1] - times_ns[0] > jump_ns:
        for index, until_ns in enumerate([*times_ns[1:], end_ns]):
            yield from (
                (index, message)
                for _, message in sampled(
                    recording, topics, [times_ns[index]], min(until_ns, times_ns[index] + PATIENCE_NS), most
                )
            )
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
