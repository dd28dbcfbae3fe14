# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from multilica import read_extrinsics
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import (
    Invoke,
    command_of_process,
    environment_of_process,
    true_pose,
    write_pcd,
)

WRITTEN = {"calibration.toml", "config.toml", "recording.rrd", "report.html", "result.json", "result.mcap"}


@pytest.mark.slow
def test_a_run_ends_with_a_table_and_what_was_written(invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--target", "left", "--out", "run")
    assert outcome.code == ExitCode.DONE
    rows = {words[0]: words for line in outcome.out.splitlines() if (words := line.split())}
    assert rows["left"][1] == "target"
    assert rows["right"][1] == "placed"
    truth = true_pose("left", "right")
    assert [float(number) for number in rows["right"][2:5]] == pytest.approx(truth.xyz_m, abs=0.02)
    assert [float(number) for number in rows["right"][5:8]] == pytest.approx(truth.rpy_deg, abs=0.2)
    assert {line.removeprefix("wrote ") for line in outcome.out.splitlines() if line.startswith("wrote ")} == {
        f"run/{name}" for name in WRITTEN
    }
    assert {path.name for path in Path("run").iterdir()} == WRITTEN
    written = read_extrinsics(Path("run/calibration.toml")).between("left", "right")
    distance_m, angle_rad = truth.distance_to(written)
    assert distance_m < 0.02
    assert angle_rad < 0.002


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_higher_limit_of_sigma_places_an_uncertain_lidar(invoke: Invoke, two_lidars: Path) -> None:
    strict = invoke("calibrate", two_lidars, "--target", "left", "--out", "run", "--max-sigma", "0.1,0.2")
    assert strict.code == ExitCode.NOT_PLACED
    told = tomllib.loads(Path("run/calibration.toml").read_text(encoding="utf-8"))
    assert [*told["uncertain"]] == ["right"]
    assert "right" not in told["lidars"]
    assert "limit 0.1 mm" in told["uncertain"]["right"]["reason"]
    lenient = invoke("calibrate", two_lidars, "--target", "left", "--out", "run", "--max-sigma", "20,0.2")
    assert lenient.code == ExitCode.DONE
    pose = read_extrinsics(Path("run/calibration.toml")).between("left", "right")
    assert pose.xyz_m == pytest.approx(told["uncertain"]["right"]["xyz_m"], abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", pytest.param("paper-algorithm1", marks=pytest.mark.nightly)])
def test_a_preset_of_the_paper_says_what_it_accepted_by(preset: str, invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--target", "left", "--out", "run", "--preset", preset)
    assert outcome.code == ExitCode.DONE
    sentence = f"the placements were accepted by their fitness alone (preset {preset}, verify.enabled=false)"
    assert f"Warning: {sentence}" in outcome.out
    assert sentence in Path("run/report.html").read_text(encoding="utf-8")
    assert json.loads(Path("run/result.json").read_text(encoding="utf-8"))["accepted_by"] == "fitness"


@pytest.mark.slow
def test_progress_goes_to_stderr_without_colours(invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--out", "run", "--until", "features")
    assert outcome.code == ExitCode.DONE
    stages = [line.split()[0] for line in outcome.err.splitlines()]
    assert stages == ["ingest", "preprocess", "features"]
    assert "\x1b" not in outcome.err + outcome.out
    assert "stopped after stage features" in outcome.out


def test_quiet_prints_nothing(invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--out", "run", "--until", "preprocess", "--quiet")
    assert (outcome.code, outcome.out, outcome.err) == (ExitCode.DONE, "", "")
    assert Path("run/recording.rrd").is_file()


@pytest.mark.slow
def test_json_is_the_whole_of_stdout(two_lidars: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    ended = subprocess.run(
        command_of_process("calibrate", two_lidars, "--target", "left", "--out", out, "--workers", "1", "--json"),
        capture_output=True,
        check=False,
        text=True,
        env=environment_of_process(),
    )
    assert ended.returncode == ExitCode.DONE, ended.stderr
    document = json.loads(ended.stdout)
    assert document == json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert document["schema"] == "multilica/result/1"
    assert document["lidars"]["right"]["xyz_m"] == pytest.approx(true_pose("left", "right").xyz_m, abs=0.02)


@pytest.mark.slow
def test_options_reach_the_configuration_of_the_result(invoke: Invoke, two_lidars: Path) -> None:
    options = ("--until", "preprocess", "--frames", "3", "--workers", "2", "--ground", "--set", "fine.max_iterations=7")
    document = json.loads(invoke("calibrate", two_lidars, "--out", "run", "--json", *options).out)
    config = document["config"]
    assert config["ingest"]["frames"] == 3
    assert config["runtime"]["workers"] == 2
    assert config["ground"]["enabled"] is True
    assert config["fine"]["max_iterations"] == 7


@pytest.mark.slow
def test_a_lidar_that_cannot_be_placed_has_its_own_code(invoke: Invoke, two_lidars: Path) -> None:
    shutil.copytree(two_lidars, "apart")
    write_pcd(Path("apart/right.pcd"), np.random.default_rng(5).uniform(20.0, 24.0, (200, 3)))
    outcome = invoke("calibrate", "apart", "--target", "left", "--out", "run")
    assert outcome.code == ExitCode.NOT_PLACED
    assert "NOT PLACED" in outcome.out
    assert any(line.startswith("right is not placed: ") for line in outcome.out.splitlines())
    assert json.loads(Path("run/result.json").read_text(encoding="utf-8"))["status"] == "failed"


def test_files_on_the_command_line_are_one_snapshot(invoke: Invoke, two_lidars: Path) -> None:
    files = (two_lidars / "right.pcd", two_lidars / "left.pcd")
    outcome = invoke("calibrate", *files, "--out", "run", "--until", "preprocess", "--json")
    assert set(json.loads(outcome.out)["lidars"]) == {"left", "right"}


@pytest.mark.slow
def test_a_closed_pipe_ends_the_command_in_silence(two_lidars: Path) -> None:
    with subprocess.Popen(
        command_of_process("inspect", two_lidars),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment_of_process(),
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == ExitCode.BROKEN
