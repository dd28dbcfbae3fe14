# SPDX-License-Identifier: Apache-2.0
"""Latched messages from a server of the Foxglove WebSocket protocol."""

import json
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from threading import Thread

from multilica.documents import DocumentError, parse_json
from multilica.errors import UsageError
from multilica.optional_libraries import needed_for
from multilica.sinks.mcap.messages import McapMessage

with needed_for("Serving Foxglove", "websockets"):
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import ServerConnection, serve
    from websockets.typing import Subprotocol

_SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, subscription, log time."""
_MESSAGE_DATA = 1
_MAX_REQUEST_BYTES = 1 << 16


@contextmanager
def from_foxglove_server(messages: Sequence[McapMessage], host: str, port: int) -> Iterator[int]:
    """Send each message to whoever subscribes to its topic, within the block.

    Yields:
        The port, another one than `port` if that is 0.

    Raises:
        UsageError: the port is taken, or the host is not of this machine.
    """

    def talk(connection: ServerConnection) -> None:
        with suppress(ConnectionClosed):
            _talk(connection, messages)

    try:
        server = serve(talk, host, port, subprotocols=_SUBPROTOCOLS, compression=None, max_size=_MAX_REQUEST_BYTES)
    except (OSError, OverflowError) as error:
        raise UsageError(f"No server can be opened at {host}:{port}: {error}.") from error
    with server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield int(server.socket.getsockname()[1])
        finally:
            server.shutdown()
            thread.join()


def _talk(connection: ServerConnection, messages: Sequence[McapMessage]) -> None:
    connection.send(json.dumps({"op": "serverInfo", "name": "multilica", "capabilities": []}))
    channels = [
        {
            "id": number,
            "topic": message.topic,
            "encoding": message.schema.message_encoding,
            "schemaName": message.schema.name,
            "schema": message.schema.data.decode(),
            "schemaEncoding": message.schema.encoding,
        }
        for number, message in enumerate(messages)
    ]
    connection.send(json.dumps({"op": "advertise", "channels": channels}))
    for request in connection:
        for subscription, number in _subscriptions(request):
            if 0 <= number < len(messages):
                head = _MESSAGE_HEAD.pack(_MESSAGE_DATA, subscription, time.time_ns())
                connection.send(head + messages[number].data)


def _subscriptions(request: str | bytes) -> list[tuple[int, int]]:
    """Return subscription and channel of each subscription that a client asks for; what is not valid is ignored."""
    try:
        table = parse_json(request) if isinstance(request, str) else None
        if isinstance(table, dict) and table.get("op") == "subscribe":
            wanted = [(each["id"], each["channelId"]) for each in table["subscriptions"]]
            return [pair for pair in wanted if all(type(number) is int and 0 <= number < 1 << 32 for number in pair)]
    except (DocumentError, KeyError, TypeError, RecursionError):
        pass
    return []
