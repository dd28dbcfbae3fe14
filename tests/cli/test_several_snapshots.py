# SPDX-License-Identifier: Apache-2.0
"""Several snapshots of one rig on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from multilica import read_extrinsics
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import ROOT, Invoke, assert_one_sentence, true_pose, write_recording

SCHEMA = json.loads((ROOT / "docs" / "reference" / "result.schema.json").read_text(encoding="utf-8"))
WRITTEN = {"calibration.toml", "config.toml", "recording.rrd", "report.html", "result.json", "result.mcap"}
FEWER = ("--set", "fine.max_finalists=2")


@pytest.mark.in_turn
@pytest.mark.slow
def test_an_outlier_and_a_refused_snapshot_are_named(invoke: Invoke, snapshots: Path) -> None:
    sources = [snapshots / f"{name}.mcap" for name in ("first", "turned", "alone", "second")]
    outcome = invoke("calibrate", *sources, "--target", "right", "--out", "run", *FEWER)
    assert outcome.code == ExitCode.DONE, outcome.err
    told = {line.split(":")[0]: line for line in outcome.out.splitlines() if line.startswith("snapshot ")}
    assert "agrees" in told["snapshot first"]
    assert "OUTLIER: left is off by" in told["snapshot turned"]
    assert "left out" in told["snapshot alone"]
    assert "only one LiDAR (right)" in told["snapshot alone"]
    assert {path.name for path in Path("run").iterdir()} == WRITTEN | {"first", "turned", "second"}
    for name in ("first", "turned", "second"):
        assert {path.name for path in Path("run", name).iterdir()} == WRITTEN
    found = read_extrinsics(Path("run/calibration.toml")).between("right", "left")
    distance_m, angle_rad = true_pose("right", "left").distance_to(found)
    assert distance_m < 0.02
    assert angle_rad < 0.002
    document = json.loads(Path("run/result.json").read_text(encoding="utf-8"))
    jsonschema.validate(document, SCHEMA)
    assert [report["outliers"] for report in document["snapshots"]] == [[], ["left"], [], []]
    assert document["snapshots"][2]["refusal"]
    assert document["lidars"]["left"]["spread"]["snapshots"] == 2
    assert document["input"]["source"] == "first.mcap, turned.mcap, alone.mcap, second.mcap"
    evaluated = json.loads(invoke("evaluate", "run", "run/turned", "--truth", find_sample().truth, "--json").out)
    assert [row["outcome"] for row in evaluated["lidars"]] == ["within", "false_accept"]


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_lidar_of_a_refused_snapshot_only_is_listed(invoke: Invoke, snapshots: Path, tmp_path: Path) -> None:
    blind = {"right": np.full((10, 3), np.nan), "top": np.random.default_rng(0).uniform(-9.0, 9.0, (500, 3))}
    sources = [snapshots / "first.mcap", snapshots / "second.mcap", write_recording(tmp_path / "third.mcap", blind)]
    outcome = invoke("calibrate", *sources, "--out", "run", *FEWER)
    assert outcome.code == ExitCode.NOT_PLACED, outcome.err
    assert "1 of 3 LiDARs is not placed. top: " in outcome.out
    document = json.loads(Path("run/result.json").read_text(encoding="utf-8"))
    jsonschema.validate(document, SCHEMA)
    assert document["lidars"]["top"]["reason"].startswith("third: left out: third.mcap has finite points of top only")
    assert "By snapshot: third: left out: " in invoke("explain", "run").out


def test_without_a_usable_snapshot_an_older_joint_result_stays(invoke: Invoke, snapshots: Path) -> None:
    Path("run").mkdir()
    Path("run/result.json").write_text("{}", encoding="utf-8")
    sources = [snapshots / "alone.mcap", snapshots / "alone_too.mcap"]
    outcome = invoke("calibrate", *sources, "--out", "run", "--quiet")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "None of 2 snapshots can be used" in outcome.err
    assert "The earlier result in run is unchanged." in outcome.err
    assert Path("run/result.json").read_text(encoding="utf-8") == "{}"


@pytest.mark.parametrize(
    ("names", "options", "named"),
    [
        (("first", "second", "other"), (), "and none of those of the other recordings (left, right)"),
        (("first", "first"), (), "given more than once"),
        (("first", "second"), ("--until", "fine"), "--until fine"),
        (("first", "second"), ("--preset", "paper"), "preset paper"),
    ],
)
def test_what_cannot_be_joined_is_refused_before_any_work(
    names: tuple[str, ...], options: tuple[str, ...], named: str, invoke: Invoke, snapshots: Path
) -> None:
    outcome = invoke("calibrate", *(snapshots / f"{name}.mcap" for name in names), "--out", "run", *options)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert named in outcome.err
    assert not Path("run").exists()


def test_an_unknown_target_is_refused_before_any_work(invoke: Invoke, snapshots: Path) -> None:
    sources = [snapshots / "first.mcap", snapshots / "second.mcap"]
    outcome = invoke("calibrate", *sources, "--out", "run", "--target", "rigth")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "Did you mean 'right'?" in outcome.err
    assert not Path("run").exists()
