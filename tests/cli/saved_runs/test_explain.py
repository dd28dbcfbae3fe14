# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, write_pcd


@pytest.fixture
def run_of_a_dead_lidar(invoke: Invoke, two_lidars: Path) -> tuple[Path, str]:
    """A run with a third LiDAR that returned nothing, and what `calibrate` printed."""
    shutil.copytree(two_lidars, "scans")
    write_pcd(Path("scans/rear.pcd"), np.full((20, 3), np.nan))
    return Path("run"), invoke("calibrate", "scans", "--out", "run", "--target", "left").out


@pytest.mark.slow
@pytest.mark.in_turn
def test_all_files_of_a_run_explain_the_same_cause(
    run_of_a_dead_lidar: tuple[Path, str], invoke: Invoke, tmp_path: Path
) -> None:
    run, printed = run_of_a_dead_lidar
    cause = "rear is not placed: it returned nothing (dead sensor or empty topic)."
    assert cause in printed.splitlines()[-3:]
    told = invoke("explain", run)
    assert told.code == ExitCode.DONE
    assert cause in told.out.splitlines()
    assert any(line.split()[:2] == ["right", "placed"] for line in told.out.splitlines())
    shutil.copy(run / "recording.rrd", tmp_path / "alone.rrd")
    assert invoke("explain", tmp_path / "alone.rrd").out == told.out
    assert invoke("explain", run / "result.json").out == told.out
    assert invoke("explain", run / "result.mcap").out == told.out


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_explanation_as_json(run_of_a_dead_lidar: tuple[Path, str], invoke: Invoke) -> None:
    run, _ = run_of_a_dead_lidar
    document = json.loads(invoke("explain", run, "--json").out)
    assert [(one["lidar"], one["cause"]) for one in document["missing"]] == [("rear", "dead_sensor")]
    assert [one["lidar"] for one in document["placed"]] == ["right"]


def frames_of_a_moving_lidar(folder: Path, scan: np.ndarray) -> None:
    for index in range(3):
        write_pcd(folder / f"{index:03}.pcd", scan - [0.4 * index, 0.0, 0.0])


def moving(two_lidars: Path, folder: Path) -> Path:
    for name in ("left", "right"):
        rows = (two_lidars / f"{name}.pcd").read_text(encoding="ascii").split("DATA ascii\n")[1]
        frames_of_a_moving_lidar(folder / name, np.loadtxt(rows.splitlines()))
    return folder


@pytest.mark.slow
def test_a_refused_snapshot_leaves_what_explains_it(invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", moving(two_lidars, Path("drive")), "--out", "run", "--quiet")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "The vehicle moves" in outcome.err
    assert "`multilica explain run`" in outcome.err
    for source in ("run", "run/recording.rrd"):
        told = invoke("explain", source)
        assert told.out.startswith("Nothing was calibrated: the vehicle moved while the snapshot was taken.")
        assert "record while the vehicle stands still" in told.out


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_refused_snapshot_leaves_an_earlier_result_as_it_was(invoke: Invoke, two_lidars: Path) -> None:
    invoke("calibrate", two_lidars, "--out", "run", "--quiet", "--until", "preprocess")
    before = {path.name: path.read_bytes() for path in Path("run").iterdir()}
    outcome = invoke("calibrate", moving(two_lidars, Path("drive")), "--out", "run", "--quiet")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "The earlier result in run is unchanged." in outcome.err
    assert {path.name: path.read_bytes() for path in Path("run").iterdir() if path.is_file()} == before
    assert "moves" in invoke("explain", "run/unfinished").out


def nowhere(folder: Path) -> Path:
    return folder / "nowhere"


def empty(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


def no_recording(folder: Path) -> Path:
    (folder / "junk.rrd").write_bytes(b"no recording" * 100)
    return folder / "junk.rrd"


def no_mcap(folder: Path) -> Path:
    (folder / "junk.mcap").write_bytes(b"no mcap" * 100)
    return folder / "junk.mcap"


def another_schema(folder: Path) -> Path:
    (folder / "result.json").write_text('{"schema": "something/else"}', encoding="utf-8")
    return folder / "result.json"


def half_a_document(folder: Path) -> Path:
    (folder / "result.json").write_text('{"schema": "multilica/result/1", "status": "failed"}', encoding="utf-8")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("make", [nowhere, empty, no_recording, no_mcap, another_schema, half_a_document])
def test_what_is_no_run_is_refused(make: object, invoke: Invoke, tmp_path: Path) -> None:
    assert_one_sentence(invoke("explain", make(tmp_path)), ExitCode.INPUT)
