# SPDX-License-Identifier: Apache-2.0
"""Snapshots from a running server of foxglove-sdk, which is a process of its own."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UnreadableSourceError, UsageError
from multilica.ingest import TakenSnapshot
from multilica.ingest.snapshot_reader import listen
from tests.ingest.support.bridge_server import POSE, vehicle
from tests.ingest.support.processes import served

TOPICS = ("/lidar_0/points", "/lidar_1/points")
PATIENT = IngestConfig(frames=6, timeout_s=30.0)


def bridge(encoding: str = "cdr", port: int = 0, silent: str = "none") -> object:
    return served("bridge_server.py", encoding, port, silent)


@pytest.fixture(scope="module")
def running() -> Iterator[str]:
    """The address of a vehicle that runs during all tests."""
    with bridge() as port:
        yield f"ws://127.0.0.1:{port}"


@pytest.fixture(scope="module")
def half_silent() -> Iterator[str]:
    """The address of a vehicle whose second LiDAR sends nothing."""
    with bridge(silent="lidar_1") as port:
        yield f"ws://127.0.0.1:{port}"


def assert_scans_of_the_vehicle(live: TakenSnapshot) -> None:
    """Each scan is one that was sent, bit by bit; they come in order."""
    for lidar in live.snapshot.lidars:
        sent = {scan.points_m.tobytes(): scan.intensity for scan in vehicle()[lidar.name].scans}
        for scan in lidar.scans:
            np.testing.assert_array_equal(scan.intensity, sent[scan.points_m.tobytes()])
        stamps = [scan.stamp_ns for scan in lidar.scans]
        assert stamps == sorted(set(stamps))


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("encoding", ["cdr", "ros1", "protobuf", "json"])
def test_every_encoding_gives_the_points_that_were_sent(encoding: str) -> None:
    seen: list[tuple[str, int]] = []
    with bridge(encoding) as port:
        live = listen(
            f"ws://127.0.0.1:{port}", config=PATIENT, observe=lambda topic, count: seen.append((topic, count))
        )
    assert live.silent == ()
    assert live.snapshot.source == f"ws://127.0.0.1:{port}"
    assert live.snapshot.names == ("lidar_0", "lidar_1")
    assert live.snapshot.notes == ()
    assert [(lidar.frame_id, lidar.topic, len(lidar.scans)) for lidar in live.snapshot.lidars] == [
        ("lidar_0", TOPICS[0], 6),
        ("lidar_1", TOPICS[1], 6),
    ]
    assert_scans_of_the_vehicle(live)
    assert seen[:2] == [(topic, 0) for topic in TOPICS]
    assert {(topic, 6) for topic in TOPICS} <= set(seen)


def test_static_transforms_are_taken_even_of_a_single_frame(running: str) -> None:
    live = listen(running, config=IngestConfig(frames=1))
    (pose,) = live.snapshot.static_transforms
    assert (pose.target, pose.source) == ("base", "lidar_1")
    np.testing.assert_allclose(pose.matrix, POSE.matrix, atol=1e-12)


def test_topics_are_chosen_and_named(running: str) -> None:
    live = listen(running, config=IngestConfig(frames=2, topics={"roof": TOPICS[1]}))
    assert [(lidar.name, lidar.topic) for lidar in live.snapshot.lidars] == [("roof", TOPICS[1])]


@pytest.mark.slow
def test_a_silent_topic_is_named_and_the_others_are_kept(half_silent: str) -> None:
    live = listen(half_silent, config=IngestConfig(frames=3, timeout_s=1.5))
    assert live.silent == (TOPICS[1],)
    assert live.snapshot.names == ("lidar_0",)
    assert "'/lidar_1/points': 0 of 3 scans, then the time limit of 1.5 s is over." in live.snapshot.notes
    assert_scans_of_the_vehicle(live)


def test_a_vehicle_that_sends_nothing_is_unfit(half_silent: str) -> None:
    config = IngestConfig(frames=3, timeout_s=1.0, topics={"roof": TOPICS[1]})
    with pytest.raises(UnfitSnapshotError, match="sent no readable scan") as caught:
        listen(half_silent, config=config)
    assert TOPICS[1] in str(caught.value)


@pytest.mark.slow
def test_a_lost_connection_is_made_again() -> None:
    with ExitStack() as first, ExitStack() as second:
        port = first.enter_context(bridge())

        def restart(topic: str, count: int) -> None:
            if (topic, count) == (TOPICS[0], 3):
                first.close()
                second.enter_context(bridge("ros1", port))

        live = listen(f"ws://127.0.0.1:{port}", config=PATIENT, observe=restart)
    assert live.silent == ()
    assert [len(lidar.scans) for lidar in live.snapshot.lidars] == [6, 6]
    assert live.snapshot.notes == ()
    assert_scans_of_the_vehicle(live)


@pytest.mark.slow
def test_what_came_before_a_connection_was_lost_for_good_is_kept() -> None:
    with ExitStack() as server:
        port = server.enter_context(bridge())

        def stop(topic: str, count: int) -> None:
            if (topic, count) == (TOPICS[1], 3):
                server.close()

        config = IngestConfig(frames=10_000, timeout_s=2.0)
        live = listen(f"ws://127.0.0.1:{port}", config=config, observe=stop)
    assert live.silent == ()
    assert 3 <= len(live.snapshot["lidar_1"].scans) < 10_000
    assert all("of 10000 scans, then the connection was lost for good" in note for note in live.snapshot.notes)


def test_a_topic_that_is_not_offered_is_named(running: str) -> None:
    config = IngestConfig(timeout_s=1.0, topics={"roof": "/lidar_7/points"})
    with pytest.raises(UnknownNameError, match="/lidar_7/points"):
        listen(running, config=config)


def test_nobody_at_home_is_one_sentence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(UnreadableSourceError, match=r"Nothing answers at ws://127\.0\.0\.1:\d+ within 0\.5 s"):
        listen(f"ws://127.0.0.1:{port}", config=IngestConfig(timeout_s=0.5))


def test_another_kind_of_server_is_one_sentence(tmp_path: Path) -> None:
    with (
        served("file_server.py", tmp_path) as port,
        pytest.raises(UnreadableSourceError, match="is not a Foxglove WebSocket server"),
    ):
        listen(f"ws://127.0.0.1:{port}")


@pytest.mark.parametrize(
    "window", [{"start_s": 3.0}, {"start_at": "1700000000"}, {"window": "auto"}, {"window_s": 9.0}]
)
def test_a_live_window_begins_now(window: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="begins now"):
        listen("ws://127.0.0.1:9", config=IngestConfig(**window))


@pytest.mark.parametrize("url", ["ws://", "ws://:8765", "ws://h:99999", "wss://h:x", "ws://[::1"])
def test_addresses_that_are_not_valid_are_refused(url: str) -> None:
    with pytest.raises(UsageError, match=r"is not valid; expected wss?://HOST or wss?://HOST:PORT"):
        listen(url)


def test_patterns_choose_topics(running: str) -> None:
    live = listen(running, config=IngestConfig(frames=1, only=("/lidar_*/points",)))
    assert live.snapshot.names == ("lidar_0", "lidar_1")


@pytest.mark.slow
def test_strict_refuses_what_is_not_whole(half_silent: str) -> None:
    config = IngestConfig(frames=2, timeout_s=1.5, strict=True)
    with pytest.raises(UnfitSnapshotError, match=r"lidar_1.* 0 of 2 scans"):
        listen(half_silent, config=config)


def test_secrets_of_the_address_are_not_shown(running: str) -> None:
    secret = running.replace("ws://", "ws://fleet:hunter2@") + "/?token=hunter2"
    assert listen(secret, config=IngestConfig(frames=1)).snapshot.source == f"{running}/"
