# SPDX-License-Identifier: Apache-2.0
"""Exit codes, as a table, and what each `--until` leaves."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, LidarPlacement
from multilica.run import CalibrationRun
from multilica_cli.exit_codes import ExitCode, exit_code
from tests.cli.support import ROOT, Invoke, write_pcd
from tests.selection import some_of

CODES = {"DONE": 0, "BROKEN": 1, "USAGE": 2, "INPUT": 3, "NOT_PLACED": 4, "DIFFERENT": 5}
PLACES_LIDARS = {
    "ingest": False,
    "preprocess": False,
    "features": False,
    "correspond": False,
    "coarse": False,
    "verify": False,
    "fine": False,
    "merge": True,
    "refine": True,
    "ground": True,
}


def test_codes_are_those_of_the_documentation(invoke: Invoke):
    assert {code.name: code.value for code in ExitCode} == CODES
    assert tuple(PLACES_LIDARS) == STAGES == get_args(Stage)
    epilog = re.search(r"Exit codes: (.*)", " ".join(invoke("--help").out.split()))[1]
    assert {int(number) for number in re.findall(r"(\d+) ", epilog)} == {*CODES.values(), 130, 143, 129}
    page = (ROOT / "docs" / "reference" / "exit-codes.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([\d, ]+) \| (.*) \|$", page, re.MULTILINE))
    assert {*rows} == {*map(str, CODES.values()), "130, 143, 129"}
    words = ("placed", "system error", "usage", "input", "not placed", "diff")
    assert [code for code, word in enumerate(words) if word not in rows[str(code)]] == []


@pytest.mark.parametrize("statuses", [("placed",), ("uncertain",), ("not_placed",), ("placed", "not_placed")], ids=str)
@pytest.mark.parametrize("until", STAGES)
def test_a_run_is_done_if_all_is_placed_or_nothing_was_to_be(until, statuses):
    others = tuple(
        LidarPlacement(
            f"lidar {index}",
            "made",
            status,
            None if status == "not_placed" else RigidTransform.identity("target", f"lidar {index}"),
        )
        for index, status in enumerate(statuses)
    )
    target = LidarPlacement("target", "the target", "placed", RigidTransform.identity("target", "target"))
    result = CalibrationResult("target", "made", (target, *others))
    run = CalibrationRun(result, CalibrationConfig(until=until), Path(), ())
    incomplete = PLACES_LIDARS[until] and {*statuses} != {"placed"}
    assert exit_code(run) == (ExitCode.NOT_PLACED if incomplete else ExitCode.DONE)


@pytest.fixture(scope="module")
def apart(two_lidars: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two LiDARs that share nothing."""
    folder = tmp_path_factory.mktemp("apart") / "apart"
    shutil.copytree(two_lidars, folder)
    write_pcd(folder / "right.pcd", np.random.default_rng(5).uniform(20.0, 24.0, (200, 3)))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("until", some_of(STAGES, 1))
def test_each_until_stops_after_its_stage(until, invoke: Invoke, two_lidars: Path, apart: Path):
    options = ("--target", "left", "--out", "run", "--until", until, "--ground", "--workers", "1")
    placed = invoke("calibrate", two_lidars, *options, "--quiet")
    assert placed.code == ExitCode.DONE, placed.err
    document = json.loads(Path("run/result.json").read_text(encoding="utf-8"))
    assert document["progress"] == {"finished": [*STAGES[: STAGES.index(until) + 1]], "running": None}
    assert document["lidars"]["right"]["placed"] is PLACES_LIDARS[until]
    assert (document["ground"] is not None) is (until == "ground")
    refused = invoke("calibrate", apart, *options, "--quiet")
    assert refused.code == (ExitCode.NOT_PLACED if PLACES_LIDARS[until] else ExitCode.DONE), refused.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("--version",), 0),
        (("--help",), 0),
        ((), 2),
        (("calibrate",), 2),
        (("calibrate", "nowhere.mcap", "--until", "nonsense"), 2),
        (("calibrate", "nowhere.mcap", "--set", "fine.nonsense=1"), 2),
        (("calibrate", "nowhere.mcap", "--preset", "nonsense"), 2),
        (("calibrate", "nowhere.mcap", "--max-sigma", "20"), 2),
        (("calibrate", "nowhere.mcap"), 3),
        (("inspect", "nowhere.mcap"), 3),
        (("record", "nowhere.mcap", "--out", "a.mcap"), 3),
        (("record", "nowhere.mcap", "--out", "a.bag"), 2),
        (("explain", "nowhere"), 3),
        (("diff", "nowhere", "nowhere"), 3),
        (("diff", "nowhere"), 2),
        (("diff", "nowhere", "nowhere", "--within-m", "-1"), 2),
        (("view", "nowhere", "--png", "a.png"), 3),
        (("report", "nowhere"), 3),
        (("config", "--preset", "nonsense"), 2),
        (("config",), 0),
        (("doctor",), 0),
        (("simulate", "--rig", "nonsense", "--scene", "street", "--out", "a.mcap"), 2),
        (("evaluate", "nowhere", "--truth", "nowhere.toml"), 3),
        (("datasets", "nonsense", "nowhere"), 2),
        (("datasets", "helipr", "nowhere"), 3),
        (("nonsense",), 2),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else str(value),
)
def test_each_command_ends_with_its_code(arguments, code, invoke: Invoke):
    outcome = invoke(*arguments)
    assert outcome.code == code, outcome
