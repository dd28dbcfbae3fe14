# SPDX-License-Identifier: Apache-2.0
"""Whatever a user can get wrong ends in one sentence and its exit code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, write_pcd


def empty(folder: Path) -> Path:
    path = folder / "empty.mcap"
    path.touch()
    return path


def not_what_its_name_says(folder: Path) -> Path:
    path = folder / "notes.mcap"
    path.write_text("Measured on Tuesday, it rained.\n" * 20, encoding="utf-8")
    return path


def cut_off_before_any_scan(folder: Path) -> Path:
    whole = without_point_clouds(folder)
    path = folder / "cut.mcap"
    path.write_bytes(whole.read_bytes()[:60])
    return path


def without_point_clouds(folder: Path) -> Path:
    path = folder / "chatter.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, log_time=1, data=b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00", publish_time=1)
        writer.finish()
    return path


def one_lidar_only(folder: Path) -> Path:
    write_pcd(folder / "lonely" / "front.pcd", np.random.default_rng(1).uniform(-5, 5, (500, 3)))
    return folder / "lonely"


def only_nans(folder: Path) -> Path:
    for name in ("front", "rear"):
        write_pcd(folder / "blind" / f"{name}.pcd", np.full((50, 3), np.nan))
    return folder / "blind"


def empty_directory(folder: Path) -> Path:
    (folder / "nothing").mkdir()
    return folder / "nothing"


def truncated_pcd(folder: Path) -> Path:
    for name in ("front", "rear"):
        path = write_pcd(folder / "torn" / f"{name}.pcd", np.random.default_rng(1).uniform(-5, 5, (500, 3)))
        path.write_bytes(path.read_bytes()[:90])
    return folder / "torn"


def missing(folder: Path) -> Path:
    return folder / "nowhere.mcap"


UNFIT = [
    missing,
    empty,
    not_what_its_name_says,
    cut_off_before_any_scan,
    without_point_clouds,
    one_lidar_only,
    only_nans,
    empty_directory,
    truncated_pcd,
]


@pytest.mark.parametrize("make", UNFIT)
def test_calibrate_refuses_unfit_input(make: object, invoke: Invoke, tmp_path: Path) -> None:
    source = make(tmp_path)
    outcome = invoke("calibrate", source, "--out", "run")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert outcome.out == ""
    assert not Path("run").exists()


@pytest.mark.parametrize(
    ("make", "code"), [(missing, "not_found"), (empty, "unreadable"), (one_lidar_only, "too_few_lidars")]
)
def test_a_refusal_is_json_if_json_is_asked_for(make: object, code: str, invoke: Invoke, tmp_path: Path) -> None:
    outcome = invoke("calibrate", make(tmp_path), "--json", "--out", "run")
    assert_one_sentence(outcome, ExitCode.INPUT)
    document = json.loads(outcome.out)
    assert document == {"status": "failed", "refusal": {"code": code, "text": document["refusal"]["text"]}}
    assert outcome.err == f"multilica: {document['refusal']['text']}\n"
    other = invoke("calibrate", tmp_path, "--rig", "nowhere.toml", "--json")
    assert (other.code, json.loads(other.out)["refusal"]["code"]) == (ExitCode.INPUT, "not_found")


def test_a_name_that_begins_with_a_tilde_is_a_name(invoke: Invoke, tmp_path: Path) -> None:
    empty(tmp_path).rename(tmp_path / "~nobody.mcap")
    for source in ("./~nobody.mcap", "~nobody.mcap"):
        outcome = invoke("calibrate", source, "--out", "./~nobody")
        assert_one_sentence(outcome, ExitCode.INPUT)
        assert outcome.err.startswith("multilica: ~nobody.mcap is empty")
    assert_one_sentence(invoke("calibrate", tmp_path, "--rig", "./~nobody.toml"), ExitCode.INPUT)


@pytest.mark.parametrize("make", [missing, empty, not_what_its_name_says, cut_off_before_any_scan])
def test_inspect_refuses_what_cannot_be_read(make: object, invoke: Invoke, tmp_path: Path) -> None:
    assert_one_sentence(invoke("inspect", make(tmp_path)), ExitCode.INPUT)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--target", "lfet"], "left"),
        (["--topic", "front=/nope"], "/nope"),
        (["--topic", "front"], "left.pcd"),
        (["--topic", "=/x"], "NAME=/topic"),
        (["--topic", "a=/x", "--topic", "a=/y"], "'a'"),
        (["--set", "fine.max_iteration=3"], "fine.max_iterations"),
        (["--set", "fine.max_iterations=many"], "fine.max_iterations"),
        (["--set", "fine"], "section.key=value"),
        (["--preset", "paper", "--set", "fine.rotation_epsilon_rad=0.01"], "no effect with fine.engine=open3d"),
        (["--preset", "paper", "--set", "coarse.max_hypotheses=2"], "no effect with coarse.solver=teaserpp"),
        (["--max-sigma", "50"], "--max-sigma 50,0.5"),
        (["--max-sigma", "50,0.5,1"], "--max-sigma 50,0.5"),
        (["--max-sigma", "-50,0.5"], "two numbers above zero"),
        (["--max-sigma", "50,nan"], "two numbers above zero"),
        (["--max-sigma", "wide,0.5"], "'wide,0.5'"),
        (["--preset", "papper"], "paper"),
        (["--preset", "paper", "--config", "some.toml"], "--config"),
        (["--until", "mrege"], "merge"),
        (["--frames", "0"], "ingest.frames"),
        (["--topic", "/lidar_*"], "left.pcd"),
        (["--window", "best"], "--window"),
        (["--duration", "-1"], "ingest.window_s"),
        (["--frames", "ten"], "--frames"),
        (["--workers", "-1"], "runtime.workers"),
        (["--mcap-encoding", "ros3"], "ros3"),
        (["--no-such-option"], "--no-such-option"),
    ],
)
def test_calibrate_refuses_unknown_names(options: list[str], named: str, invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--out", "run", *options)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert named in outcome.err
    assert not Path("run").exists()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["calibrate"], "SOURCE"),
        (["calibarte"], "calibarte"),
        (["config", "--json", "--toml"], "--json"),
        (["simulate", "--rig", "edgra", "--scene", "street", "--out", "a.mcap"], "edgar"),
        (["simulate", "--rig", "edgar", "--scene", "steret", "--out", "a.mcap"], "street"),
        (["simulate", "--rig", "edgar", "--scene", "street", "--out", "a.bag"], ".mcap"),
        (["simulate", "--rig", "edgar", "--scene", "street", "--disturb", "snwo", "--out", "a.mcap"], "snwo"),
        (["simulate", "--rig", "edgar", "--scene", "street", "--frames", "0", "--out", "a.mcap"], "frames"),
    ],
)
def test_commands_refuse_what_does_not_exist(arguments: list[str], named: str, invoke: Invoke) -> None:
    outcome = invoke(*arguments)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert named in outcome.err
    assert list(Path().iterdir()) == []


def test_an_unreadable_configuration_is_named(invoke: Invoke, two_lidars: Path) -> None:
    Path("broken.toml").write_text("[fine\n", encoding="utf-8")
    outcome = invoke("calibrate", two_lidars, "--config", "broken.toml")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "broken.toml" in outcome.err


def test_a_directory_that_cannot_be_made_is_told(invoke: Invoke, two_lidars: Path) -> None:
    Path("file").touch()
    outcome = invoke("calibrate", two_lidars, "--out", "file/run", "--quiet")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "file/run" in outcome.err


def test_a_missing_library_names_the_command(invoke: Invoke, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multilica.optional_libraries.is_found", lambda module: module != "kiss_matcher")
    write_pcd(tmp_path / "scans" / "front.pcd", [[1.0, 2.0, 3.0]])
    outcome = invoke("calibrate", "scans", "--set", "coarse.solver=kiss_matcher", "--workers", "1")
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "`pip install 'multilica[kiss]'`" in outcome.err
    assert not Path("recordings").exists()
