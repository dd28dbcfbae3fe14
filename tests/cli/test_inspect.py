# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from multilica.ingest import inspect_source, read_snapshot
from multilica.ingest.summary import Standstill
from multilica.snapshot import Snapshot
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.commands.recordings import _print_sources
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, write_pcd
from tests.ingest.support.recording_writers import make_snapshot, write_mcap


def test_the_sample_is_described(invoke: Invoke) -> None:
    outcome = invoke("inspect", find_sample().recording)
    assert outcome.code == 0
    assert outcome.err == ""
    for text in (
        "MCAP",
        "/lidar/front/points",
        "PointCloud2",
        "/tf_static",
        "front (2 of 2 frames)",
        "Static transforms",
    ):
        assert text in outcome.out
    assert "\x1b" not in outcome.out


def test_names_that_would_steer_a_terminal_are_shown(invoke: Invoke) -> None:
    first, second = make_snapshot().lidars
    odd = replace(first, name="roof\x1b[2J", frame_id="roof\x1b[2J", topic="/\x9b31m[/bold]/points")
    write_mcap(Snapshot((odd, second)), Path("odd.mcap"))
    outcome = invoke("inspect", "odd.mcap")
    assert outcome.code == ExitCode.DONE
    assert "roof\\x1b[2J" in outcome.out
    assert "/\\x9b31m[/bold]/points" in outcome.out
    refusal = invoke("inspect", "odd.mcap", "--topic", "/none")
    assert_one_sentence(refusal, ExitCode.USAGE)
    assert "/\\x9b31m[/bold]/points" in refusal.err
    assert not {"\x1b", "\x9b"} & {*outcome.out, *refusal.err}


def test_the_document_holds_what_calibrate_would_take(invoke: Invoke) -> None:
    outcome = invoke("inspect", find_sample().recording, "--json", "--frames", "1", "--topic", "eye=/lidar/rear/points")
    document = json.loads(outcome.out)
    assert document["schema"] == "multilica/inspect/1"
    taken = {cloud["lidar"]: cloud["frames_taken"] for cloud in document["clouds"] if cloud["lidar"]}
    assert taken == {"eye": 1}
    rear = next(transform for transform in document["static_transforms"] if transform["child"] == "rear")
    assert rear["parent"] == "base"
    assert rear["xyz_m"] == pytest.approx([-1.5, 0.0, 2.1], abs=0.3)
    assert "eye" in document["objection"]


def test_what_calibrate_would_refuse_is_shown_then_told(invoke: Invoke, tmp_path: Path) -> None:
    write_pcd(tmp_path / "lonely" / "front.pcd", [(1.0, 2.0, 3.0)] * 9)
    outcome = invoke("inspect", "lonely")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "at least two" in outcome.err
    assert "front.pcd" in outcome.out


def test_a_time_may_be_seconds_since_the_epoch(invoke: Invoke) -> None:
    begin_ns = min(scan.stamp_ns for lidar in read_snapshot(find_sample().recording).lidars for scan in lidar.scans)
    outcome = invoke("inspect", find_sample().recording, "--start", f"{begin_ns / 1e9 + 0.05:.3f}", "--json")
    taken = {cloud["frames_taken"] for cloud in json.loads(outcome.out)["clouds"]}
    assert taken == {1}
    beyond = invoke("inspect", find_sample().recording, "--start", f"{begin_ns / 1e9 + 1000.0:.0f}")
    assert_one_sentence(beyond, ExitCode.INPUT)
    assert "has no point cloud at" in beyond.err


def test_sources_and_standstills(invoke: Invoke) -> None:
    """Each of several sources is taken for something; a file of a tenth of a second has no standstill to list."""
    for stop in ("stop1", "stop2"):
        Path(stop).mkdir()
        for name in ("front.npy", "rear.npy"):
            np.save(Path(stop) / name, np.eye(3, dtype=np.float32))
    lines = invoke("inspect", "stop1", "stop2").out.splitlines()
    assert [line for line in lines if "taken for" in line] == [
        "stop1 is taken for LiDARs of one snapshot",
        "stop2 is taken for LiDARs of one snapshot",
    ]
    document = json.loads(invoke("inspect", find_sample().recording, "--json").out)
    assert list(document["taken_for"].values()) == ["a recording"]
    assert (document["standstills"], document["standstill_evidence"]) == ([], "")


def test_standstills_are_printed() -> None:
    printed = StringIO()
    console = Console(file=printed, width=200)
    standstills = (Standstill(0.0, 2.0), Standstill(5.6, 2.5))
    found = inspect_source(find_sample().recording)
    _print_sources(replace(found, standstills=standstills, standstill_evidence="odometry on '/odom'"), console)
    line = printed.getvalue().splitlines()[1]
    assert line == "The vehicle stands still, by odometry on '/odom': from 0.0 s for 2.0 s, 5.6 s for 2.5 s"
