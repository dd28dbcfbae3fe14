# SPDX-License-Identifier: Apache-2.0
"""The messages of a running vehicle."""

import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import replace

from multilica.errors import UnreadableSourceError
from multilica.ingest.live.foxglove_socket import (
    Advertised,
    ConnectionLost,
    FoxgloveSocket,
    Received,
    UnadvertiseMessage,
)
from multilica.ingest.recording import MessageObserver, Messages, RawMessage, Topic
from multilica.ingest.remote.address import without_secrets

_FIRST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 5.0
_STATIC_S = 1.0
"""A bridge sends latched messages to a new subscriber at once."""
_STATIC_SUFFIX = "tf_static"
_MAX_STATIC = 256
"""Messages with static transforms to keep; a vehicle sends a handful."""
_MAX_CHANNELS = 10_000
_MAX_ODDITIES = 100
_MAX_TEXT = 200
_QUICK_S = 1.0
"""A server that ends connections sooner than this is not asked again at once."""


class LiveRecording:
    """The messages of a Foxglove WebSocket server up to a time limit, with reconnects.

    Args:
        expected: messages per topic that the caller will wait for.
        timeout_s: from now to the time limit.

    Raises:
        UnreadableSourceError: no such server answers before the time limit.
    """

    format = "Foxglove WebSocket"
    is_indexed = False

    def __init__(self, url: str, expected: int, timeout_s: float, observe: MessageObserver) -> None:
        self.damage = ""
        self._url = url
        self._expected = expected
        self._timeout_s = timeout_s
        self._end_s = time.monotonic() + timeout_s
        self._observe = observe
        self._channels: dict[int, Topic] = {}
        self._wanted: frozenset[str] = frozenset()
        self._static: list[RawMessage] = []
        self._counts: Counter[str] = Counter()
        self._oddities: Counter[str] = Counter()
        self._connected_s = 0.0
        self._socket = self._connect()

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics offered now, each with the expected number of messages."""
        offered = (replace(topic, count=self._expected) for topic in self._channels.values())
        return tuple(sorted(offered, key=lambda topic: topic.name))

    @property
    def notes(self) -> list[str]:
        """Notes on messages that were ignored."""
        if not self._oddities:
            return []
        (first, _), *_ = self._oddities.items()
        count = self._oddities.total()
        messages = "1 message that was" if count == 1 else f"{count} messages that were"
        return [f"{without_secrets(self._url)} sent {messages} ignored; the first one {first[:_MAX_TEXT]}."]

    def wait_for(self, is_offered: Callable[[], bool]) -> None:
        """Listen until the server offers what is needed, or time is up."""
        while not is_offered() and self._left_s() > 0.0:
            self._next(self._left_s())

    def span_ns(self, topics: Collection[str]) -> None:
        """Return None: the end is not known."""

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages as they arrive up to the time limit, and earlier static transforms; ignore `start_ns`."""
        del start_ns
        static = {topic.name for topic in self._channels.values() if topic.name.endswith(_STATIC_SUFFIX)}
        added = (static | set(topics)) - self._wanted
        self._wanted |= added
        self._subscribe([number for number, topic in self._channels.items() if topic.name in added])
        yield from (message for message in self._static if message.topic in topics)
        limit_s = self._limit_s(topics)
        while (left_s := limit_s - time.monotonic()) > 0.0:
            message = self._next(left_s)
            if message is not None and message.topic in topics:
                yield message
        if not self.damage and self._left_s() <= 0.0:
            self.damage = f"the time limit of {self._timeout_s:g} s is over"

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _limit_s(self, topics: Collection[str]) -> float:
        """Return when to stop waiting: static transforms arrive at once or not at all."""
        if not all(topic.endswith(_STATIC_SUFFIX) for topic in topics):
            return self._end_s
        return 0.0 if self._static else time.monotonic() + _STATIC_S

    def _left_s(self) -> float:
        return self._end_s - time.monotonic()

    def _subscribe(self, numbers: Collection[int]) -> None:
        if numbers:
            try:
                self._socket.subscribe(numbers)
            except ConnectionLost:
                self._reconnect()

    def _next(self, timeout_s: float) -> RawMessage | None:
        try:
            received = self._socket.receive(timeout_s)
        except ConnectionLost as error:
            if error.oddity:
                self._count_oddity(error.oddity)
            self._reconnect()
            return None
        match received:
            case Advertised(channels, oddity):
                if oddity:
                    self._count_oddity(oddity)
                if len(self._channels) + len(channels) > _MAX_CHANNELS:
                    self._count_oddity(f"offers more than {_MAX_CHANNELS} channels")
                    return None
                self._channels |= channels
                self._subscribe([number for number, topic in channels.items() if topic.name in self._wanted])
            case UnadvertiseMessage(channelIds=numbers):
                self._channels = {key: topic for key, topic in self._channels.items() if key not in numbers}
            case str(oddity):
                self._count_oddity(oddity)
            case Received(subscription) if subscription in self._channels:
                return self._message(self._channels[subscription], received)
        return None

    def _message(self, topic: Topic, received: Received) -> RawMessage:
        message = topic.message(received.log_time_ns, received.data, without_secrets(self._url))
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

    def _reconnect(self) -> None:
        self._socket.close()
        if time.monotonic() - self._connected_s < _QUICK_S:
            time.sleep(max(0.0, min(_QUICK_S, self._left_s())))
        # A restarted server numbers its channels anew, and advertises them to new clients.
        self._channels = {}
        try:
            self._socket = self._connect()
        except UnreadableSourceError:
            # The earlier messages are still useful.
            self.damage, self._end_s = "the connection was lost for good", time.monotonic()

    def _connect(self) -> FoxgloveSocket:
        pause_s = _FIRST_PAUSE_S
        while True:
            try:
                self._connected_s = time.monotonic()
                return FoxgloveSocket(self._url, max(self._left_s(), _FIRST_PAUSE_S))
            except ConnectionLost as error:
                if self._left_s() <= pause_s:
                    raise UnreadableSourceError(
                        f"Nothing answers at {without_secrets(self._url)} within {self._timeout_s:g} s; "
                        "check the address (port 8765 in most vehicles), and that foxglove_bridge runs."
                    ) from error
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
