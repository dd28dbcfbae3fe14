# SPDX-License-Identifier: Apache-2.0
"""Servers that say what nobody understands."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import pytest
from websockets.sync.server import ServerConnection, serve

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError
from multilica.ingest.live import foxglove
from multilica.ingest.live.foxglove import (
    Advertised,
    BridgeRecording,
    ConnectionLost,
    FoxgloveSocket,
    UnadvertiseMessage,
)
from multilica.ingest.recording import Topic
from multilica.ingest.snapshot_reader import listen
from tests.ingest.support.recording_writers import (
    CLOUD,
    START_NS,
    TRANSFORMS,
    make_snapshot,
    raw_messages,
    ros2_types,
)

GOOD = {"id": 2, "topic": "/a", "schemaName": "s", "encoding": "cdr"}
OF_OTHER_OPERATIONS = [json.dumps({"op": "status", "message": "hello"}), b"\x7f" + bytes(40)]
ODDITIES = [
    "no JSON",
    "[]",
    "{}",
    "null",
    '{"op": 7}',
    json.dumps({"op": "advertise"}),
    '{"op": "advertise", "channels": {"a": 1}}',
    '{"op": "unadvertise", "channelIds": [1e999]}',
    '{"op": "unadvertise", "channelIds": [%s]}' % ("9" * 5000),
    '{"op": "unadvertise", "channelIds": [-1, true, "1"]}',
    '{"op": "advertise", "channels": ' + "[" * 50_000 + "]" * 50_000 + "}",
    '{"op": "advertise", "channels": ' + '{"a":' * 50_000 + "1" + "}" * 50_000 + "}",
    '{"op": NaN}',
    "\x00\u202e",
    b"",
    b"\x01\x00",
]
ODD_CHANNELS = [
    {}, {**GOOD, "id": "x"}, None, 3, {"id": 1, "topic": "/b"}, {**GOOD, "id": 1.5}, {**GOOD, "id": True},
    {**GOOD, "id": 1 << 40}, {**GOOD, "id": -1}, {**GOOD, "topic": ["/a"]}, {**GOOD, "topic": "/" * 5000},
    [[[[]]]], {**GOOD, "schemaName": None},
]  # fmt: skip


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


def test_other_operations_are_passed_over() -> None:
    goodbye = json.dumps({"op": "unadvertise", "channelIds": [2]})
    assert heard([*OF_OTHER_OPERATIONS, goodbye]) == [None, None, UnadvertiseMessage(op="unadvertise", channelIds=(2,))]


def test_what_makes_no_sense_is_an_oddity() -> None:
    goodbye = json.dumps({"op": "unadvertise", "channelIds": [2]})
    *odd, last = heard([*ODDITIES, goodbye])
    assert all(isinstance(each, str) and each for each in odd)
    assert last == UnadvertiseMessage(op="unadvertise", channelIds=(2,))


def test_oddities_are_counted_and_told() -> None:
    cloud = json.dumps({"op": "advertise", "channels": [{**GOOD, "schemaName": CLOUD}, *ODD_CHANNELS]})
    ((_, _, _, data),) = raw_messages(make_snapshot(lidars=1, frames=1), ros2_types(), "cdr")
    message = b"\x01" + struct.pack("<IQ", 2, START_NS) + data
    with saying([*ODDITIES, cloud, *ODDITIES, message]) as url:
        taken = listen(url, config=IngestConfig(frames=1, timeout_s=10.0))
    (note,) = taken.snapshot.notes
    assert (
        f"sent {2 * len(ODDITIES) + 1} messages that were ignored; the first one is not JSON: Expecting value" in note
    )
    assert note.isprintable()
    assert taken.snapshot.lidars[0].points_count == 50


@pytest.mark.parametrize(
    ("schema", "topics", "said"),
    [
        (
            CLOUD,
            {},
            "scan on /lidar_000, /lidar_001, /lidar_002, /lidar_003, /lidar_004 and 295 more within",
        ),
        (CLOUD, {"a": "/b"}, "available: /lidar_000, /lidar_001, /lidar_002, /lidar_003, /lidar_004 and 295 more."),
        ("kind", {}, "found kind_000, kind_001, kind_002, kind_003, kind_004 and 295 more."),
    ],
)
def test_hundreds_of_topics_are_told_by_their_number(schema: str, topics: dict[str, str], said: str) -> None:
    names = [schema if schema == CLOUD else f"{schema}_{number:03d}" for number in range(300)]
    channels = [
        {**GOOD, "id": number, "topic": f"/lidar_{number:03d}", "schemaName": name} for number, name in enumerate(names)
    ]
    config = IngestConfig(frames=1, timeout_s=0.5, topics=topics)
    with (
        saying([json.dumps({"op": "advertise", "channels": channels})]) as url,
        pytest.raises((UnfitSnapshotError, UnknownNameError)) as caught,
    ):
        listen(url, config=config)
    assert said in str(caught.value)
    assert "/lidar_150" not in str(caught.value)


@pytest.mark.slow
def test_a_message_without_bounds_ends_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foxglove, "_MAX_MESSAGE_BYTES", 1000)
    with saying([b"\x01" + bytes(10_000)]) as url, pytest.raises(UnfitSnapshotError, match="holds no point clouds"):
        listen(url, config=IngestConfig(frames=1, timeout_s=2.5))
    with saying([b"\x01" + bytes(10_000)]) as url:
        connection = FoxgloveSocket(url, 5.0)
        with pytest.raises(ConnectionLost) as caught:
            connection.receive(5.0)
        connection.close()
    assert caught.value.oddity == "has more than 1000 bytes"


@pytest.mark.slow
def test_a_flood_of_static_transforms_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    static = {"id": 3, "topic": "/tf_static", "schemaName": TRANSFORMS, "encoding": "cdr"}
    cloud = {**GOOD, "schemaName": CLOUD}
    flood = [b"\x01" + struct.pack("<IQ", 3, START_NS) + bytes(100_000)] * 2000
    kept: list[int] = []
    close = BridgeRecording.close
    monkeypatch.setattr(
        BridgeRecording,
        "close",
        lambda self: (kept.append(len(self._static)), close(self))[1],
    )
    with saying([json.dumps({"op": "advertise", "channels": [static, cloud]}), *flood]) as url:
        config = IngestConfig(frames=1, timeout_s=4.0, max_memory_mb=60)
        with pytest.raises(UnfitSnapshotError, match="sent no readable scan"):
            listen(url, config=config)
    assert kept == [256]


def test_half_a_surrogate_pair_is_no_topic() -> None:
    advertised = json.dumps({"op": "advertise", "channels": [{**GOOD, "topic": "/\ud800"}]})
    assert heard([advertised]) == [Advertised({2: Topic("/?", "s", "cdr")})]


@pytest.mark.parametrize("odd", ODD_CHANNELS)
def test_an_odd_channel_does_not_cost_the_others(odd: object) -> None:
    (found,) = heard([json.dumps({"op": "advertise", "channels": [odd, GOOD]})])
    assert isinstance(found, Advertised)
    assert found.channels == {2: Topic("/a", "s", "cdr")}
    assert "offers a channel that is not of the protocol" in found.oddity
