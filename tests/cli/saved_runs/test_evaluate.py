# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.support import Invoke, assert_one_sentence
from tests.runs.made_runs import entry, made_result, write_run, write_truth

GOOD = ((0.003, 0.004, 0.0), (0.0, 0.0, 0.05))
BAD = ((0.3, 0.4, 0.0), (0.0, 0.0, 5.0))


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    write_truth(Path("t.toml"))
    write_run(Path("runs/a"), {"left": GOOD, "rear": BAD})
    write_run(Path("runs/b"), {"left": GOOD, "rear": None})


def test_tables_for_people(invoke: Invoke) -> None:
    outcome = invoke("evaluate", "runs/a", "runs/b/result.json", "--truth", "t.toml", "--out", "table.csv")
    assert outcome.code == 0
    rows = [line.split() for line in outcome.out.splitlines()]
    assert ["a", "left", "within", "3.0", "4.0", "0.0", "5.0", "0.000", "0.000", "0.050", "0.050", "-"] in rows
    assert any(row[:3] == ["rear", "FALSE", "ACCEPT"] for row in rows)
    assert [
        "all",
        "4",
        "2",
        "(50.0%)",
        "0",
        "(0.0%)",
        "1",
        "(25.0%)",
        "1",
        "(25.0%)",
        "0",
        "(0.0%)",
        "0",
        "(0.0%)",
    ] in rows
    assert "runs with every compared LiDAR within tolerance: 0 of 2" in outcome.out
    assert outcome.out.splitlines()[-1] == "wrote table.csv"
    assert Path("table.csv").is_file()


def test_json_for_programs(invoke: Invoke) -> None:
    outcome = invoke("evaluate", "runs/a", "runs/b", "--truth", "t.toml", "--truth", "t.toml", "--json")
    document = json.loads(outcome.out)
    assert outcome.code == 0
    overall = document["overall"]
    assert [overall[key] for key in ("lidars", "within", "false_accept", "false_refuse")] == [4, 2, 1, 1]
    assert document["by_lidar"]["left"]["rmse"]["distance_m"] == pytest.approx(0.005)
    assert document["tolerances"] == pytest.approx(
        {"within_m": 0.02, "within_deg": 0.1, "wrong_m": 0.05, "wrong_deg": 0.5, "wrong_sigma": 4.0}
    )


def test_limits_can_be_set(invoke: Invoke) -> None:
    limits = ("--within-m", "0.6", "--within-deg", "6", "--wrong-m", "0.7", "--wrong-deg", "7")
    outcome = invoke("evaluate", "runs/a", "--truth", "t.toml", "--json", *limits)
    assert json.loads(outcome.out)["overall"]["success_rate"] == 1.0


def test_small_errors_beyond_four_sigma_are_false_accepts(invoke: Invoke) -> None:
    write_run(Path("runs/c"), {"left": GOOD}, sigmas=(0.05, 0.0005))
    outcome = invoke("evaluate", "runs/c", "--truth", "t.toml")
    assert "or 4 sigma" in outcome.out
    row = next(line.split() for line in outcome.out.splitlines() if "FALSE ACCEPT" in line)
    assert float(row[-1]) == pytest.approx(9.0, abs=0.1)
    lenient = invoke("evaluate", "runs/c", "--truth", "t.toml", "--json", "--wrong-sigma", "10")
    assert json.loads(lenient.out)["overall"]["within"] == 1


def test_what_is_left_out_is_said(invoke: Invoke) -> None:
    write_truth(Path("less.toml"), ["front", "left"])
    outcome = invoke("evaluate", "runs/a", "--truth", "less.toml")
    assert outcome.code == 0
    assert "left out: runs/a, LiDAR rear: less.toml does not have it" in outcome.out.splitlines()


def test_many_lidars_list_only_what_is_not_within(invoke: Invoke) -> None:
    runs = [write_run(Path(f"many/{index}"), {"left": GOOD}) for index in range(41)]
    outcome = invoke("evaluate", *runs, "runs/a", "--truth", "t.toml")
    assert "; 42 LiDARs within tolerance are not listed" in outcome.out
    assert sum("FALSE ACCEPT" in line for line in outcome.out.splitlines()) == 1


def test_quiet_says_nothing(invoke: Invoke) -> None:
    assert invoke("evaluate", "runs/a", "--truth", "t.toml", "--quiet").out == ""


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["runs/a"], 2, "--truth"),
        (["--truth", "t.toml"], 2, "RUN"),
        (["runs/none", "--truth", "t.toml"], 3, "No run at runs/none"),
        (["runs", "--truth", "t.toml"], 3, "not the directory of a finished run"),
        (["t.toml", "--truth", "t.toml"], 3, "not a JSON file"),
        (["other.json", "--truth", "t.toml"], 3, "has schema 'other/1'; expected 'multilica/result/1'"),
        (["list.json", "--truth", "t.toml"], 3, "has schema None"),
        (["bent.json", "--truth", "t.toml"], 3, "not a whole result"),
        (["poseless.json", "--truth", "t.toml"], 3, "`lidars` has a LiDAR that is placed without a pose"),
        (["runs/a", "--truth", "none.toml"], 3, "No extrinsics file at none.toml"),
        (["runs/a", "runs/b", "runs/a", "--truth", "t.toml"], 2, "given more than once"),
        (["runs/a", "runs/b/../a/result.json", "--truth", "t.toml"], 2, "given more than once"),
        (["runs/a", "--truth", "t.toml", "--truth", "t.toml"], 2, "Found 2 truths for 1 run"),
        (["runs/a", "--truth", "t.toml", "--out", "table.xlsx"], 2, "table.xlsx"),
        (["runs/a", "--truth", "t.toml", "--within-m", "nan"], 2, "limits above zero"),
        (["runs/a", "--truth", "t.toml", "--wrong-sigma", "0"], 2, "Found 'wrong' 0 sigma"),
        (["singular.json", "--truth", "t.toml"], 3, "the covariance of LiDAR 'left' is not"),
    ],
)
def test_failures_are_one_sentence(arguments: list[str], code: int, words: str, invoke: Invoke) -> None:
    singular = {**entry(None), "covariance": [[0.0] * 6] * 6}
    documents = {
        "other": {"schema": "other/1"},
        "list": [1],
        "bent": {"schema": "multilica/result/1", "target": "front", "lidars": [1]},
        "singular": made_result("front", {"left": singular}),
        "poseless": made_result("front", {"left": {**entry(None), "placed": True, "status": "placed"}}),
    }
    for name, document in documents.items():
        Path(f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    outcome = invoke("evaluate", *arguments)
    assert_one_sentence(outcome, code)
    assert words in outcome.err


def test_the_table_of_the_paper(invoke: Invoke) -> None:
    outcome = invoke("evaluate", "runs/a", "runs/b", "--truth", "t.toml", "--table", "paper")
    assert outcome.code == 0
    rows = [line.split() for line in outcome.out.splitlines()]
    assert ["a", "left", "front", "success", "3.0", "4.0", "0.0"] in [row[:7] for row in rows]
    assert any(row[:4] == ["b", "rear", "front", "NOT"] for row in rows)
    left = next(row for row in rows if row[:2] == ["left", "2"])
    assert left[1:9] == ["2", "2", "(100%)", "2", "(100%)", "3.0", "4.0", "0.0"]
    between = next(row for row in rows if row[:3] == ["rear", "in", "left"])
    assert between[3:8] == ["2", "1", "(50%)", "0", "(0%)"]
    document = json.loads(invoke("evaluate", "runs/a", "--truth", "t.toml", "--table", "paper", "--json").out)
    assert (document["schema"], document["to_target"]["successes"]) == ("multilica/paper-table/1", 1)
