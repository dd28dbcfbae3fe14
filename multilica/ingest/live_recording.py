# SPDX-License-Identifier: Apache-2.0
"""A running vehicle as a recording that is still being made."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection

from multilica.errors import UnreadableSourceError
from multilica.ingest.address import without_secrets
from multilica.ingest.foxglove_socket import Advertised, Channel, ConnectionLost, FoxgloveSocket, Received, Withdrawn
from multilica.ingest.recording import Message, MessageObserver, Messages, Span, Topic, normal_type

__all__ = ["LiveRecording"]

_FIRST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 5.0
_STATIC_S = 1.0
"""A bridge repeats latched messages to whoever subscribes, at once."""
_STATIC_SUFFIX = "tf_static"


class LiveRecording:
    """What a Foxglove WebSocket server sends until a time limit; a lost connection is made again.

    Args:
        url: ``ws://`` or ``wss://``.
        expected: messages per topic that the user of this recording will wait for.
        timeout_s: seconds from now to the time limit.
        observe: told of each message.

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
        self._channels: dict[int, Channel] = {}
        self._wanted: frozenset[str] = frozenset()
        self._static: list[Message] = []
        self._counts: Counter[str] = Counter()
        self._socket = self._connected()

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Those that are offered at the moment, each said to have as many messages as are expected."""
        return tuple(
            Topic(channel.topic, normal_type(channel.schema_name), channel.encoding, self._expected)
            for channel in sorted(self._channels.values(), key=lambda channel: channel.topic)
        )

    def wait_for(self, is_offered: Callable[[], bool]) -> None:
        """Listen until the server offers what is needed, or time is up."""
        while not is_offered() and self._left_s() > 0.0:
            self._next(self._left_s())

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """None: nobody knows when it will end."""
        del topics
        return None

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """As they arrive, up to the time limit; static transforms also from before. `start_ns` has no meaning."""
        del start_ns
        self._want(topics)
        yield from (message for message in self._static if message.topic in topics)
        limit_s = self._limit_s(topics)
        while (left_s := limit_s - time.monotonic()) > 0.0:
            message = self._next(left_s)
            if message is not None and message.topic in topics:
                yield message
        if not self.damage and self._left_s() <= 0.0:
            self.damage = f"the time limit of {self._timeout_s:g} s is over"

    def close(self) -> None:
        """Say goodbye."""
        self._socket.close()

    def _limit_s(self, topics: Collection[str]) -> float:
        """Static transforms come at once or not at all."""
        if not all(topic.endswith(_STATIC_SUFFIX) for topic in topics):
            return self._end_s
        return 0.0 if self._static else time.monotonic() + _STATIC_S

    def _left_s(self) -> float:
        return self._end_s - time.monotonic()

    def _want(self, topics: Collection[str]) -> None:
        static = {channel.topic for channel in self._channels.values() if channel.topic.endswith(_STATIC_SUFFIX)}
        added = (static | set(topics)) - self._wanted
        self._wanted |= added
        self._subscribe([channel for channel in self._channels.values() if channel.topic in added])

    def _subscribe(self, channels: Collection[Channel]) -> None:
        if channels:
            try:
                self._socket.subscribe(channel.number for channel in channels)
            except ConnectionLost:
                self._reconnect()

    def _next(self, timeout_s: float) -> Message | None:
        try:
            heard = self._socket.receive(timeout_s)
        except ConnectionLost:
            self._reconnect()
            return None
        match heard:
            case Advertised(channels):
                self._channels |= {channel.number: channel for channel in channels}
                self._subscribe([channel for channel in channels if channel.topic in self._wanted])
            case Withdrawn(numbers):
                self._channels = {key: value for key, value in self._channels.items() if key not in numbers}
            case Received(subscription) if subscription in self._channels:
                return self._message(self._channels[subscription], heard)
        return None

    def _message(self, channel: Channel, received: Received) -> Message:
        origin = f"From {without_secrets(self._url)}, a scan of '{channel.topic}'"
        message_type = normal_type(channel.schema_name)
        message = Message(channel.topic, message_type, channel.encoding, received.log_time_ns, received.data, origin)
        if channel.topic.endswith(_STATIC_SUFFIX):
            self._static.append(message)
        else:
            self._counts[channel.topic] += 1
            self._observe(channel.topic, self._counts[channel.topic])
        return message

    def _reconnect(self) -> None:
        self._socket.close()
        # A server that was started anew numbers its channels anew, and says so when it is connected to.
        self._channels = {}
        try:
            self._socket = self._connected()
        except UnreadableSourceError:
            # What came before is of use.
            self.damage, self._end_s = "the connection was lost for good", time.monotonic()

    def _connected(self) -> FoxgloveSocket:
        pause_s = _FIRST_PAUSE_S
        while True:
            try:
                return FoxgloveSocket(self._url, max(self._left_s(), _FIRST_PAUSE_S))
            except ConnectionLost as error:
                if self._left_s() <= pause_s:
                    raise UnreadableSourceError(
                        f"Nothing answers at {without_secrets(self._url)} within {self._timeout_s:g} s; "
                        "check the address (port 8765 in most vehicles), and that foxglove_bridge runs."
                    ) from error
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
