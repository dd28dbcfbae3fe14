# SPDX-License-Identifier: Apache-2.0
"""Servers that say what nobody understands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import pytest
from websockets.sync.server import ServerConnection, serve

from multilica.ingest.live.foxglove_socket import Advertised, FoxgloveSocket, Withdrawn
from multilica.ingest.recording import Topic

GOOD = {"id": 2, "topic": "/a", "schemaName": "s", "encoding": "cdr"}
NEVER_UNDERSTOOD = [
    "no JSON",
    "[]",
    "{}",
    json.dumps({"op": "advertise"}),
    json.dumps({"op": "status", "message": "hello"}),
    b"",
    b"\x01\x00",
    b"\x7f" + bytes(40),
]


@contextmanager
def saying(frames: list[str | bytes]) -> Iterator[str]:
    """The address of a server that says this and waits."""

    def talk(connection: ServerConnection) -> None:
        for frame in frames:
            connection.send(frame)
        connection.recv()

    with serve(talk, "127.0.0.1", 0, subprotocols=["foxglove.sdk.v1"]) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join()


def heard(frames: list[str | bytes]) -> list[object]:
    with saying(frames) as url:
        connection = FoxgloveSocket(url, 10.0)
        found = [connection.receive(10.0) for _ in frames]
        connection.close()
    return found


def test_what_is_not_understood_is_passed_over() -> None:
    goodbye = json.dumps({"op": "unadvertise", "channelIds": [2]})
    assert heard([*NEVER_UNDERSTOOD, goodbye]) == [*[None] * len(NEVER_UNDERSTOOD), Withdrawn(frozenset({2}))]


def test_half_a_surrogate_pair_is_no_topic() -> None:
    advertised = json.dumps({"op": "advertise", "channels": [{**GOOD, "topic": "/\ud800"}]})
    assert heard([advertised]) == [Advertised({2: Topic("/?", "s", "cdr")})]


@pytest.mark.parametrize("odd", [{}, {**GOOD, "id": "x"}, None, 3, {"id": 1, "topic": "/b"}])
def test_an_odd_channel_does_not_cost_the_others(odd: object) -> None:
    (found,) = heard([json.dumps({"op": "advertise", "channels": [odd, GOOD]})])
    assert found == Advertised({2: Topic("/a", "s", "cdr")})
