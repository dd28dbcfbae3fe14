# SPDX-License-Identifier: Apache-2.0
"""A connection to a Foxglove WebSocket server."""

import json
import ssl
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationError

from multilica.documents import DocumentError, first_problem, parse_json
from multilica.errors import UnreadableSourceError
from multilica.ingest.memory import memory_budget
from multilica.ingest.recording import Topic, normal_type, sanitize_text
from multilica.ingest.remote.address import without_secrets
from multilica.optional_libraries import needed_for

with needed_for("Listening to a running vehicle", "websockets"):
    from websockets.exceptions import (
        ConnectionClosed,
        InvalidHandshake,
        InvalidStatus,
        InvalidURI,
        WebSocketException,
    )
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

_SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Subprotocols of foxglove-sdk and foxglove_bridge 3 or newer, and of older bridges; the messages are the same."""
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, subscription, log time."""
_MESSAGE_DATA = 1
_MAX_MESSAGE_BYTES = 64 << 20
"""Twenty times the size of a large scan."""
_MAX_WAITING = 4
"""Messages that the library receives ahead."""
_TOO_BIG = 1009
_CLOSE_S = 1.0
_SERVER_TROUBLE = 500


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


class AdvertiseMessage(BaseModel):
    """An advertisement; an invalid channel does not affect the others."""

    model_config = ConfigDict(frozen=True)

    op: Literal["advertise"]
    channels: Annotated[tuple[object, ...], Field(max_length=10_000)]


class UnadvertiseMessage(BaseModel):
    """The end of an advertisement."""

    model_config = ConfigDict(frozen=True)

    op: Literal["unadvertise"]
    channelIds: Annotated[tuple[_Number, ...], Field(max_length=10_000)]


class OtherMessage(BaseModel):
    """A message of another operation: the protocol has more, and gets more."""

    model_config = ConfigDict(frozen=True)

    op: _Text


_MESSAGES: Mapping[str, type[BaseModel]] = {"advertise": AdvertiseMessage, "unadvertise": UnadvertiseMessage}


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
                close_timeout=_CLOSE_S,
                max_size=_MAX_MESSAGE_BYTES,
                max_queue=_MAX_WAITING,
            )
        except (InvalidHandshake, InvalidURI) as error:
            if isinstance(error, InvalidStatus) and error.response.status_code >= _SERVER_TROUBLE:
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
            is_too_big = isinstance(error, ConnectionClosed) and error.sent is not None and error.sent.code == _TOO_BIG
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
        model = _MESSAGES.get(OtherMessage.model_validate(table).op)
        message = None if model is None else model.model_validate(table)
    except DocumentError as error:
        return f"is not JSON: {error}"
    except ValidationError as error:
        where, what, _ = first_problem(error)
        return f"is not of the protocol: {where or 'it'}: {what}"
    if isinstance(message, AdvertiseMessage):
        return _advertised(message.channels)
    return message if isinstance(message, UnadvertiseMessage) else None


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
