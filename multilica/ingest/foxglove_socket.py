# SPDX-License-Identifier: Apache-2.0
"""A connection to a Foxglove WebSocket server."""

from __future__ import annotations

import json
import ssl
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from websockets.exceptions import InvalidHandshake, InvalidStatus, InvalidURI, WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from multilica.errors import UnreadableSourceError
from multilica.ingest.address import without_secrets
from multilica.ingest.encodable import encodable

__all__ = ["Advertised", "Channel", "ConnectionLost", "FoxgloveSocket", "Received", "Withdrawn"]

_SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Of foxglove-sdk (also foxglove_bridge 3 and newer), of foxglove_bridge before; both speak the same messages."""
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, subscription, log time."""
_MESSAGE_DATA = 1
_MAX_MESSAGE_BYTES = 256 << 20
_CLOSE_S = 1.0
_SERVER_TROUBLE = 500


class ConnectionLost(Exception):  # noqa: N818 - an event rather than an error: the caller connects again
    """The server does not answer, or not any more."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic that the server offers."""

    number: int
    topic: str
    schema_name: str
    encoding: str


@dataclass(frozen=True, slots=True)
class Advertised:
    """The server offers these channels from now on."""

    channels: tuple[Channel, ...]


@dataclass(frozen=True, slots=True)
class Withdrawn:
    """The server does not offer these channels any more."""

    numbers: frozenset[int]


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A message of a channel that was subscribed to; `subscription` is the number of that channel."""

    subscription: int
    log_time_ns: int
    data: memoryview


class FoxgloveSocket:
    """An open connection.

    Args:
        url: ``ws://`` or ``wss://``.
        timeout_s: for the connection to be made.

    Raises:
        ConnectionLost: nothing answers there yet.
        UnreadableSourceError: what answers is no such server, or the address makes no sense.
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
            )
        except (InvalidHandshake, InvalidURI) as error:
            if isinstance(error, InvalidStatus) and error.response.status_code >= _SERVER_TROUBLE:
                raise ConnectionLost(str(error)) from error
            raise UnreadableSourceError(
                f"What answers at {where} is no Foxglove WebSocket server; expected foxglove_bridge or foxglove-sdk."
            ) from error
        except ssl.SSLError as error:
            raise UnreadableSourceError(
                f"The secure connection to {where} cannot be made ({error.reason or 'unknown reason'}); "
                "check its certificate, or use ws:// within the vehicle."
            ) from error
        except (OSError, EOFError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error
        if self._socket.subprotocol is None:
            self._socket.close()
            raise UnreadableSourceError(
                f"The server at {where} speaks none of {', '.join(_SUBPROTOCOLS)}; expected foxglove_bridge or "
                "foxglove-sdk."
            )

    def subscribe(self, numbers: Iterable[int]) -> None:
        """Ask for the messages of these channels.

        Raises:
            ConnectionLost: the server is gone.
        """
        wanted = [{"id": number, "channelId": number} for number in numbers]
        try:
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        except (OSError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error

    def receive(self, timeout_s: float) -> Advertised | Withdrawn | Received | None:
        """What the server says next; None for what is of no interest, or if it says nothing for so long.

        Raises:
            ConnectionLost: the server is gone.
        """
        try:
            frame = self._socket.recv(timeout=timeout_s)
        except TimeoutError:
            return None
        except (OSError, EOFError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error
        return _text(frame) if isinstance(frame, str) else _binary(frame)

    def close(self) -> None:
        """Say goodbye."""
        self._socket.close()


def _text(frame: str) -> Advertised | Withdrawn | None:
    try:
        table = json.loads(frame)
        if table["op"] == "advertise":
            channels = map(_channel, table["channels"])
            return Advertised(tuple(channel for channel in channels if channel is not None))
        if table["op"] == "unadvertise":
            return Withdrawn(frozenset(int(number) for number in table["channelIds"]))
    except (ValueError, TypeError, KeyError):
        # The protocol has more operations than are understood here, and grows.
        return None
    return None


def _channel(entry: dict[str, Any]) -> Channel | None:
    try:
        return Channel(int(entry["id"]), *(encodable(entry[key]) for key in ("topic", "schemaName", "encoding")))
    except (ValueError, TypeError, KeyError):
        # One that makes no sense is no reason to do without the others.
        return None


def _binary(frame: bytes) -> Received | None:
    if len(frame) < _MESSAGE_HEAD.size or frame[0] != _MESSAGE_DATA:
        return None
    _, subscription, log_time_ns = _MESSAGE_HEAD.unpack_from(frame)
    return Received(subscription, log_time_ns, memoryview(frame)[_MESSAGE_HEAD.size :])
