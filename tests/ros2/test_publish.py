# SPDX-License-Identifier: Apache-2.0
"""A saved run on topics of ROS 2 and for Foxglove."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

from multilica.config import CalibrationConfig, IngestConfig
from multilica.errors import UnfitSnapshotError, UsageError
from multilica.exports.publication import publication_of
from multilica.ingest import listen, read_snapshot
from multilica.pointcloud2 import MERGED_TOPIC
from multilica.sinks.live.foxglove_server import from_foxglove_server
from multilica.sinks.run_directory import open_run
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.ros2.processes import HERE, NEEDS_ROS2, PYTHON, environment
from tests.sinks.made_events import TRUTH, made_events

SUBPROTOCOL = "foxglove.sdk.v1"
NONSENSE = ["no JSON", "[]", "{}", '{"op": "subscribe"}', b"\x00", "[" * 5000,
            '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 0}, {"id": 1e3, "channelId": "0"}]}',
            '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 7}]}']  # fmt: skip


@pytest.fixture(scope="module")
def run_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that places all LiDARs; its target is `top`."""
    directory = tmp_path_factory.mktemp("run")
    with open_run(directory, CalibrationConfig(), "foxglove") as run:
        for event in made_events():
            run(event)
    return directory


def points_in_base(run: Path) -> np.ndarray:
    """All points of the run's clouds, taken to the target with the true poses."""
    clouds = read_snapshot(run / "result.mcap")
    return np.concatenate([TRUTH[name].apply(clouds[name].points_m) for name in sorted(TRUTH)])


@NEEDS_ROS2
@pytest.mark.slow
def test_a_late_node_looks_up_a_transform(run_directory: Path) -> None:
    command = [PYTHON, "-m", "multilica_cli", "publish", run_directory, "ros2://", "--ws", "0", "--frames", "names"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()) as run:
        try:
            assert run.stdout.readline().startswith(
                "publishing /tf_static, /multilica/points at ros2:// and ws://127.0.0.1:"
            )
            listener = [PYTHON, HERE / "listener.py", "front left/1", "rear"]
            heard = subprocess.run(listener, capture_output=True, text=True, env=environment(), check=True, timeout=60)
            run.send_signal(signal.SIGINT)
            assert (run.wait(20), run.stderr.read()) == (130, "multilica: Stopped by SIGINT.\n")
        finally:
            run.kill()
    found = json.loads(heard.stdout)
    expected = TRUTH["front left/1"].inverse() @ TRUTH["rear"]
    np.testing.assert_allclose(found["transform"], expected.matrix, atol=1e-6)
    assert (found["frame"], found["points"]) == ("top", len(points_in_base(run_directory)))


def test_foxglove_gets_the_same(run_directory: Path) -> None:
    found = publication_of(run_directory, frames="names")
    with from_foxglove_server(found.messages, "127.0.0.1", 0) as port:
        url = f"ws://127.0.0.1:{port}"
        heard = listen(url, config=IngestConfig(frames=1, timeout_s=10.0, only=(MERGED_TOPIC,)))
        with pytest.raises(UnfitSnapshotError, match="no point clouds of LiDARs: '/multilica/points' is what"):
            listen(url, config=IngestConfig(frames=1, timeout_s=0.5))
    (cloud,) = heard.snapshot.lidars
    assert (cloud.topic, cloud.frame_id) == ("/multilica/points", "top")
    np.testing.assert_allclose(cloud.points_m, points_in_base(run_directory), rtol=0, atol=1e-5)
    assert {(pose.target, pose.source) for pose in heard.snapshot.static_transforms} == {
        ("top", "front left/1"),
        ("top", "rear"),
    }
    for pose in heard.snapshot.static_transforms:
        np.testing.assert_allclose(pose.matrix, TRUTH[pose.source].matrix, atol=1e-9)


def test_a_client_that_sends_nonsense_is_served_yet(run_directory: Path) -> None:
    messages = publication_of(run_directory, frames="names").messages
    with (
        from_foxglove_server(messages, "127.0.0.1", 0) as port,
        connect(f"ws://127.0.0.1:{port}", subprotocols=[SUBPROTOCOL]) as client,
    ):
        assert json.loads(client.recv(10))["op"] == "serverInfo"
        channels = json.loads(client.recv(10))["channels"]
        assert [channel["topic"] for channel in channels] == ["/tf_static", "/multilica/points"]
        assert {channel["schemaEncoding"] for channel in channels} == {"ros2msg"}
        for each in NONSENSE:
            client.send(each)
        client.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 5, "channelId": 0}]}))
        answer = client.recv(10)
    assert answer[:5] == b"\x01\x05\x00\x00\x00"
    assert answer[13:] == messages[0].data


def test_a_port_that_is_taken_is_one_sentence() -> None:
    with (
        from_foxglove_server((), "127.0.0.1", 0) as port,
        pytest.raises(UsageError, match=rf"No server can be opened at 127\.0\.0\.1:{port}: .*in use"),
        from_foxglove_server((), "127.0.0.1", port),
    ):
        pass


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "nowhere to publish"),
        (("ws://127.0.0.1:1",), "expected ros2://"),
        (("ros2://robot",), "ROS_DOMAIN_ID"),
        (("--ws", "front"), "expected PORT or HOST:PORT"),
        (("--ws", "99999"), "expected PORT or HOST:PORT"),
    ],
)
def test_a_wrong_place_is_one_sentence(words: tuple[str, ...], said: str, invoke: Invoke) -> None:
    outcome = invoke("publish", "run", *words)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert said in outcome.err


def test_a_run_that_is_not_there_is_one_sentence(invoke: Invoke) -> None:
    assert_one_sentence(invoke("publish", "run", "--ws", "0"), ExitCode.INPUT)
