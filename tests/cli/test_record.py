# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from multilica import read_snapshot
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.ingest.support.processes import served
from tests.ingest.support.recording_writers import make_snapshot, write_mcap


@pytest.fixture(scope="module")
def half_silent() -> Iterator[str]:
    """The address of a vehicle whose second LiDAR sends nothing."""
    with served("bridge_server.py", "cdr", 0, "lidar_1") as port:
        yield f"ws://127.0.0.1:{port}"


def test_a_log_becomes_a_snapshot(invoke: Invoke) -> None:
    outcome = invoke("record", find_sample().recording, "--out", "new/snapshot.mcap", "--frames", "1")
    assert outcome.code == ExitCode.DONE
    assert outcome.err == ""
    front = next(line for line in outcome.out.splitlines() if line.strip().startswith("front"))
    assert front.split()[:4] == ["front", "/lidar/front/points", "front", "1"]
    size, whole = (path.stat().st_size for path in (Path("new/snapshot.mcap"), find_sample().recording))
    assert outcome.out.splitlines()[-1] == f"wrote new/snapshot.mcap: {size / 1e3:.1f} kB of {whole / 1e6:.1f} MB"
    assert [len(lidar.scans) for lidar in read_snapshot("new/snapshot.mcap").lidars] == [1, 1, 1, 1]


@pytest.mark.slow
def test_a_snapshot_is_calibrated_whole_unless_told_otherwise(invoke: Invoke) -> None:
    write_mcap(make_snapshot(frames=15), Path("drive.mcap"))
    assert invoke("record", "drive.mcap", "--out", "a.mcap", "--frames", "12").code == ExitCode.DONE
    Path("mine.toml").write_text("[fine]\nmax_iterations = 7\n", encoding="utf-8")
    asked = {(): 12, ("--config", "mine.toml"): 12, ("--frames", "3"): 3, ("--set", "ingest.frames=10"): 10}
    for options, frames in asked.items():
        run = invoke("calibrate", "a.mcap", "--out", "run", "--until", "preprocess", *options)
        assert run.code == ExitCode.DONE, run
        config = tomllib.loads(Path("run/config.toml").read_text(encoding="utf-8"))
        assert config["ingest"]["frames"] == frames
    run = invoke("calibrate", "a.mcap", "--out", "again", "--until", "preprocess", "--config", "run/config.toml")
    assert tomllib.loads(Path("again/config.toml").read_text(encoding="utf-8"))["ingest"]["frames"] == 10
    assert "lidar_0 (12 of 12 frames)" in invoke("inspect", "a.mcap").out
    assert invoke("record", "a.mcap", "--out", "b.mcap").code == ExitCode.DONE
    assert [len(lidar.scans) for lidar in read_snapshot("b.mcap").lidars] == [12, 12]


def test_the_document_tells_what_was_taken(invoke: Invoke) -> None:
    topic = "roof=/lidar/left/points"
    outcome = invoke("record", find_sample().recording, "--out", "a.mcap", "--topic", topic, "--json")
    document = json.loads(outcome.out)
    assert document["schema"] == "multilica/record/1"
    assert document["source_bytes"] == find_sample().recording.stat().st_size
    assert document["out_bytes"] == Path("a.mcap").stat().st_size
    (lidar,) = document["lidars"]
    snapshot = read_snapshot("a.mcap")
    assert (lidar["lidar"], lidar["frames"], lidar["points"]) == ("roof", 2, snapshot["roof"].points_count)
    assert document["static_transforms"] == len(snapshot.static_transforms) == 4


def test_a_running_vehicle_becomes_a_snapshot(invoke: Invoke, half_silent: str) -> None:
    topic = "roof=/lidar_0/points"
    outcome = invoke("record", half_silent, "--out", "a.mcap", "--frames", "3", "--topic", topic)
    assert outcome.code == ExitCode.DONE
    assert outcome.err.splitlines() == [
        "listening for 3 scans of each LiDAR, at most 30 s",
        "/lidar_0/points: 3 of 3 scans",
    ]
    assert outcome.out.splitlines()[-1].endswith(f" {Path('a.mcap').stat().st_size / 1e3:.1f} kB")
    assert len(read_snapshot("a.mcap")["roof"].scans) == 3


@pytest.mark.slow
def test_a_silent_lidar_is_told_and_the_others_are_written(invoke: Invoke, half_silent: str) -> None:
    outcome = invoke("record", half_silent, "--out", "a.mcap", "--frames", "3", "--timeout", "1.5", "--quiet")
    assert_one_sentence(outcome, ExitCode.NOT_PLACED)
    assert "/lidar_1/points" in outcome.err
    assert read_snapshot("a.mcap").names == ("lidar_0",)


def test_a_refusal_leaves_an_earlier_snapshot_alone(invoke: Invoke, half_silent: str) -> None:
    Path("a.mcap").write_bytes(b"earlier")
    outcome = invoke(
        "record", half_silent, "--out", "a.mcap", "--topic", "roof=/lidar_1/points", "--timeout", "1", "--quiet"
    )
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "/lidar_1/points" in outcome.err
    assert [path.name for path in Path().iterdir()] == ["a.mcap"]
    assert Path("a.mcap").read_bytes() == b"earlier"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["bag", "--out", "a.bag"], ".mcap"),
        (["bag/drive.mcap", "--out", "bag/drive.mcap"], "the source itself"),
        (["bag", "--out", "bag/drive.mcap"], "the source itself"),
        (["bag", "ws://127.0.0.1:9", "--out", "a.mcap", "--quiet"], "give it alone"),
        (["ws://127.0.0.1:9", "--out", "a.mcap", "--start", "3", "--quiet"], "begins now"),
        (["ftp://host/a.mcap", "--out", "a.mcap"], "ftp://host/a.mcap"),
        (["bag", "--out", "a.mcap", "--timeout", "0"], "ingest.timeout_s"),
        (["bag"], "--out"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments: list[str], named: str, invoke: Invoke) -> None:
    Path("bag").mkdir()
    shutil.copy(find_sample().recording, "bag/drive.mcap")
    outcome = invoke("record", *arguments)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert named in outcome.err
    assert [path.name for path in Path().rglob("*")] == ["bag", "drive.mcap"]


@pytest.mark.slow
def test_a_running_vehicle_is_inspected(invoke: Invoke, half_silent: str) -> None:
    outcome = invoke("inspect", half_silent, "--frames", "3", "--timeout", "1.5", "--json")
    document = json.loads(outcome.out)
    assert outcome.code == ExitCode.INPUT
    assert "has only one LiDAR (lidar_0)" in document["objection"]
    assert {cloud["topic"]: cloud["frames"] for cloud in document["clouds"]} == {
        "/lidar_0/points": 3,
        "/lidar_1/points": 0,
    }
    assert {other["topic"]: other["count"] for other in document["others"]} == {"/chatter": None, "/tf_static": None}
    assert [transform["child"] for transform in document["static_transforms"]] == ["lidar_1"]


@pytest.mark.parametrize("option", ["--calibration", "--against"])
def test_other_commands_lead_to_record(option: str, invoke: Invoke) -> None:
    command = {"--calibration": "verify", "--against": "check"}[option]
    Path("a.toml").touch()
    outcome = invoke(command, "ws://127.0.0.1:8765", option, "a.toml")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "multilica record" in outcome.err
