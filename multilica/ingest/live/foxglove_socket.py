# SPDX-License-Identifier: Apache-2.0
"""A connection to a Foxglove WebSocket server."""

import json
import ssl
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from websockets.exceptions import InvalidHandshake, InvalidStatus, InvalidURI, WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from multilica.errors import UnreadableSourceError
from multilica.ingest.recording import Topic, normal_type, sanitize_text
from multilica.ingest.remote.address import without_secrets

__all__ = ["Advertised", "ConnectionLost", "FoxgloveSocket", "Received", "Withdrawn"]

_SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Of foxglove-sdk and foxglove_bridge 3 or newer, and of older bridges; the messages are the same."""
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, subscription, log time."""
_MESSAGE_DATA = 1
_MAX_MESSAGE_BYTES = 256 << 20
_CLOSE_S = 1.0
_SERVER_TROUBLE = 500


class ConnectionLost(Exception):  # noqa: N818 - an event rather than an error: the caller connects again
    """The server does not answer."""


@dataclass(frozen=True, slots=True)
class Advertised:
    """Topics that the server offers from now on, by channel number."""

    channels: Mapping[int, Topic]


@dataclass(frozen=True, slots=True)
class Withdrawn:
    """Numbers of channels that the server no longer offers."""

    numbers: frozenset[int]


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A message of the channel with the number `subscription`."""

    subscription: int
    log_time_ns: int
    data: memoryview


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

    def receive(self, timeout_s: float) -> Advertised | Withdrawn | Received | None:
        """Return the next event, None for others or without any in time; raise ConnectionLost if the server is gone."""
        try:
            frame = self._socket.recv(timeout=timeout_s)
        except TimeoutError:
            return None
        except (OSError, EOFError, WebSocketException) as error:
            raise ConnectionLost(str(error)) from error
        return _text(frame) if isinstance(frame, str) else _binary(frame)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _text(frame: str) -> Advertised | Withdrawn | None:
    # The protocol has other operations, and gets more.
    with suppress(ValueError, TypeError, KeyError):
        table = json.loads(frame)
        if table["op"] == "advertise":
            return Advertised(_channels(table["channels"]))
        if table["op"] == "unadvertise":
            return Withdrawn(frozenset(int(number) for number in table["channelIds"]))
    return None


def _channels(entries: Iterable[dict[str, Any]]) -> dict[int, Topic]:
    channels: dict[int, Topic] = {}
    for entry in entries:
        # An invalid channel does not affect the others.
        with suppress(ValueError, TypeError, KeyError):
            topic, message_type, encoding = (sanitize_text(entry[key]) for key in ("topic", "schemaName", "encoding"))
            channels[int(entry["id"])] = Topic(topic, normal_type(message_type), encoding)
    return channels


def _binary(frame: bytes) -> Received | None:
    if len(frame) < _MESSAGE_HEAD.size or frame[0] != _MESSAGE_DATA:
        return None
    _, subscription, log_time_ns = _MESSAGE_HEAD.unpack_from(frame)
    return Received(subscription, log_time_ns, memoryview(frame)[_MESSAGE_HEAD.size :])
