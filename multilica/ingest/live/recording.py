# SPDX-License-Identifier: Apache-2.0
"""The messages of a running vehicle up to a time limit, the same for every kind of source."""

import time
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from multilica.ingest.recording import MessageObserver, Messages, RawMessage, Recording, Topic

_STATIC_S = 1.0
"""Latched messages are sent to a new subscriber at once, by each node that has some."""
_STATIC_SUFFIX = "tf_static"
_MAX_STATIC = 256
"""Messages with static transforms to keep; a vehicle sends a handful."""
_MAX_ODDITIES = 100


class LiveRecording(Recording):
    """The messages of a running vehicle up to a time limit.

    Args:
        where: the source, for messages to the user.
        expected: messages per topic that the caller will wait for.
        timeout_s: from now to the time limit.
        observe: called with each message but static transforms.
    """

    is_indexed = False

    def __init__(self, where: str, expected: int, timeout_s: float, observe: MessageObserver) -> None:
        self.topics = ()
        self._where = where
        self._expected = expected
        self._timeout_s = timeout_s
        self._end_s = time.monotonic() + timeout_s
        self._observe = observe
        self._wanted: frozenset[str] = frozenset()
        self._static: list[RawMessage] = []
        self._static_end_s = 0.0
        self._counts: Counter[str] = Counter()
        self._oddities: Counter[str] = Counter()

    @abstractmethod
    def _subscribe(self, names: Collection[str]) -> None:
        """Ask for the messages on topics that are offered now."""

    @abstractmethod
    def _next(self, timeout_s: float) -> RawMessage | None:
        """Return the next message as `_received` made it; None for other events, or without any in time."""

    @property
    def notes(self) -> list[str]:
        """Notes on messages that were ignored."""
        if not self._oddities:
            return []
        (first, _), *_ = self._oddities.items()
        count = self._oddities.total()
        messages = "1 message that was" if count == 1 else f"{count} messages that were"
        return [f"{self._where} sent {messages} ignored; the first one {first[:200]}."]

    def wait_for(self, is_offered: Callable[[], bool]) -> None:
        """Listen until the vehicle offers what is needed, or time is up."""
        while not is_offered() and self._left_s() > 0.0:
            self._next(self._left_s())

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages as they arrive up to the time limit, and earlier static transforms; ignore `start_ns`."""
        del start_ns
        static = {topic.name for topic in self.topics if topic.name.endswith(_STATIC_SUFFIX)}
        added = (static | set(topics)) - self._wanted
        self._wanted |= added
        self._subscribe(added)
        if added & static:
            # The first subscriptions to a type take a second on a busy machine.
            self._static_end_s = time.monotonic() + _STATIC_S
        yield from (message for message in self._static if message.topic in topics)
        limit_s = self._end_s
        if all(topic.endswith(_STATIC_SUFFIX) for topic in topics):
            limit_s = self._static_end_s
        # The time is over at once if the connection is lost for good.
        while (left_s := min(limit_s, self._end_s) - time.monotonic()) > 0.0:
            message = self._next(left_s)
            if message is not None and message.topic in topics:
                yield message
        if not self.damage and self._left_s() <= 0.0:
            self.damage = f"the time limit of {self._timeout_s:g} s is over"

    def _offer(self, topics: Iterable[Topic]) -> None:
        """Set the topics that are offered now, each with the expected number of messages."""
        offered = (replace(topic, count=self._expected) for topic in topics)
        self.topics = tuple(sorted(offered, key=lambda topic: topic.name))

    def _left_s(self) -> float:
        return self._end_s - time.monotonic()

    def _received(self, topic: Topic, log_time_ns: int, data: memoryview) -> RawMessage:
        message = topic.message(log_time_ns, data, self._where)
        if topic.name.endswith(_STATIC_SUFFIX):
            if len(self._static) < _MAX_STATIC:
                self._static.append(message)
        else:
            self._counts[topic.name] += 1
            self._observe(topic.name, self._counts[topic.name])
        return message

    def _count_oddity(self, what: str) -> None:
        # The first ones are told; a flood of others only counts.
        self._oddities[what if len(self._oddities) < _MAX_ODDITIES else "is of another kind"] += 1
