# SPDX-License-Identifier: Apache-2.0
"""The messages of a running vehicle, by the Foxglove WebSocket protocol."""

import json
import ssl
import struct
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationError

from multilica.documents import DocumentError, first_problem, parse_json
from multilica.errors import UnreadableSourceError
from multilica.ingest.live.recording import LiveRecording
from multilica.ingest.memory import memory_budget
from multilica.ingest.recording import MessageObserver, RawMessage, Topic, normal_type, sanitize_text
from multilica.ingest.remote.address import without_secrets
from multilica.optional_libraries import needed_for

with needed_for("Listening to a running vehicle", "websockets"):
    from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, InvalidURI, WebSocketException
    from websockets.frames import CloseCode
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

_SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Subprotocols of foxglove-sdk and foxglove_bridge 3 or newer, and of older bridges; the messages are the same."""
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, subscription, log time."""
_MESSAGE_DATA = 1
_MAX_MESSAGE_BYTES = 64 << 20
"""Twenty times the size of a large scan."""

_FIRST_PAUSE_S = 0.1
_MAX_CHANNELS = 10_000
_QUICK_S = 1.0
"""A server that ends connections sooner than this is not asked again at once."""


class ConnectionLost(Exception):  # noqa: N818 - an event rather than an error: the caller connects again
    """The server does not answer; `oddity` is what it did wrong, as a predicate, if it did."""

    def __init__(self, text: str, oddity: str = "") -> None:
        self.oddity = oddity
        super().__init__(text)


@dataclass(frozen=True, slots=True)
class Advertised:
    """Topics that the server offers from now on, by channel number; `oddity` is that of an invalid channel."""

    channels: Mapping[int, Topic]
    oddity: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A message of the channel with the number `subscription`."""

    subscription: int
    log_time_ns: int
    data: memoryview


_Number = Annotated[int, Strict(), Field(ge=0, lt=1 << 32)]
_Text = Annotated[
    str,
    BeforeValidator(lambda value: sanitize_text(value) if isinstance(value, str) else value),
    Strict(),
    Field(max_length=1024),
]
"""JSON may hold half a surrogate pair, which is no valid text."""


class ChannelMessage(BaseModel):
    """A channel in an advertisement; other keys are of no use here."""

    model_config = ConfigDict(frozen=True)

    id: _Number
    topic: _Text
    encoding: _Text
    schemaName: _Text


class Operation(BaseModel):
    """A message of any operation: the protocol has more, and gets more."""

    model_config = ConfigDict(frozen=True)

    op: _Text


class AdvertiseMessage(Operation):
    """An advertisement; an invalid channel does not affect the others."""

    channels: Annotated[tuple[object, ...], Field(max_length=10_000)]


class UnadvertiseMessage(Operation):
    """The end of an advertisement."""

    channelIds: Annotated[tuple[_Number, ...], Field(max_length=10_000)]


class FoxgloveSocket:
    """An open connection.

    Raises:
        ConnectionLost: nothing answers yet.
        UnreadableSourceError: another kind of server answers, or the address is not valid.
    """

    def __init__(self, url: str, timeout_s: float) -> None:
        where = without_secrets(url)
        try:
            self._socket = connect(
                url,
                subprotocols=_SUBPROTOCOLS,
                compression=None,
                open_timeout=timeout_s,
                close_timeout=1.0,
                max_size=_MAX_MESSAGE_BYTES,
                max_queue=4,  # messages that the library receives ahead
            )
        except (InvalidHandshake, InvalidURI) as error:
            if isinstance(error, InvalidStatus) and error.response.status_code >= 500:
                raise ConnectionLost(str(error)) from error
            raise UnreadableSourceError(
                f"The server at {where} is not a Foxglove WebSocket server; expected foxglove_bridge or foxglove-sdk."
            ) from error
        except ssl.SSLError as error:
            raise UnreadableSourceError(
                f"The secure connection to {where} failed ({error.reason or 'unknown reason'}); "
                "check its certificate, or use ws:// within the vehicle."
            ) from error
        except (OSError, EOFError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error
        if self._socket.subprotocol is None:
            self._socket.close()
            raise UnreadableSourceError(
                f"The server at {where} supports none of {', '.join(_SUBPROTOCOLS)}; expected foxglove_bridge or "
                "foxglove-sdk."
            )

    def subscribe(self, numbers: Iterable[int]) -> None:
        """Subscribe to channels; raise ConnectionLost if the server is gone."""
        wanted = [{"id": number, "channelId": number} for number in numbers]
        try:
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        except (OSError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error

    def receive(self, timeout_s: float) -> Advertised | UnadvertiseMessage | Received | str | None:
        """Return the next event, None for others or without any in time, or what is wrong with it, as a predicate.

        Raises:
            ConnectionLost: the server is gone.
        """
        try:
            frame = self._socket.recv(timeout=timeout_s)
        except TimeoutError:
            return None
        except (OSError, EOFError, WebSocketException) as error:
            sent = error.sent if isinstance(error, ConnectionClosed) else None
            is_too_big = sent is not None and sent.code == CloseCode.MESSAGE_TOO_BIG
            oddity = f"has more than {_MAX_MESSAGE_BYTES} bytes" if is_too_big else ""
            raise ConnectionLost(str(error), oddity) from error
        except (UnicodeDecodeError, RecursionError) as error:
            return f"is not valid: {type(error).__name__}"
        return _text(frame) if isinstance(frame, str) else _binary(frame)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _text(frame: str) -> Advertised | UnadvertiseMessage | str | None:
    try:
        table = parse_json(frame)
        match Operation.model_validate(table).op:
            case "advertise":
                return _advertised(AdvertiseMessage.model_validate(table).channels)
            case "unadvertise":
                return UnadvertiseMessage.model_validate(table)
    except DocumentError as error:
        return f"is not JSON: {error}"
    except ValidationError as error:
        where, what, _ = first_problem(error)
        return f"is not of the protocol: {where or 'it'}: {what}"
    return None


def _advertised(entries: Iterable[object]) -> Advertised:
    channels: dict[int, Topic] = {}
    oddity = ""
    for entry in entries:
        try:
            channel = ChannelMessage.model_validate(entry)
        except ValidationError as error:
            where, what, _ = first_problem(error)
            oddity = oddity or f"offers a channel that is not of the protocol: {where or 'it'}: {what}"
        else:
            channels[channel.id] = Topic(channel.topic, normal_type(channel.schemaName), channel.encoding)
    return Advertised(channels, oddity)


def _binary(frame: bytes) -> Received | str | None:
    if not frame or (frame[0] == _MESSAGE_DATA and len(frame) < _MESSAGE_HEAD.size):
        return f"has {len(frame)} bytes, fewer than its head"
    if frame[0] != _MESSAGE_DATA:
        return None
    _, subscription, log_time_ns = _MESSAGE_HEAD.unpack_from(frame)
    return Received(subscription, log_time_ns, memory_budget().keep(frame)[_MESSAGE_HEAD.size :])


class BridgeRecording(LiveRecording):
    """The messages of a Foxglove WebSocket server, with reconnects.

    Args:
        expected, timeout_s, observe: as of `LiveRecording`.

    Raises:
        UnreadableSourceError: no such server answers before the time limit.
    """

    format = "Foxglove WebSocket"

    def __init__(self, url: str, expected: int, timeout_s: float, observe: MessageObserver) -> None:
        super().__init__(without_secrets(url), expected, timeout_s, observe)
        self._url = url
        self._channels: dict[int, Topic] = {}
        self._connected_s = 0.0
        self._socket = self._connect()

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _set_channels(self, channels: Mapping[int, Topic]) -> None:
        self._channels = dict(channels)
        self._offer(channels.values())

    def _subscribe(self, names: Collection[str]) -> None:
        self._subscribe_to([number for number, topic in self._channels.items() if topic.name in names])

    def _subscribe_to(self, numbers: Collection[int]) -> None:
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
                self._set_channels({**self._channels, **channels})
                self._subscribe_to([number for number, topic in channels.items() if topic.name in self._wanted])
            case UnadvertiseMessage(channelIds=numbers):
                self._set_channels({key: topic for key, topic in self._channels.items() if key not in numbers})
            case str(oddity):
                self._count_oddity(oddity)
            case Received(subscription) if subscription in self._channels:
                return self._received(self._channels[subscription], received.log_time_ns, received.data)
        return None

    def _reconnect(self) -> None:
        self._socket.close()
        if time.monotonic() - self._connected_s < _QUICK_S:
            time.sleep(max(0.0, min(_QUICK_S, self._left_s())))
        # A restarted server numbers its channels anew, and advertises them to new clients.
        self._set_channels({})
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
                        f"Nothing answers at {self._where} within {self._timeout_s:g} s; "
                        "check the address (port 8765 in most vehicles), and that foxglove_bridge runs."
                    ) from error
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, 5.0)
