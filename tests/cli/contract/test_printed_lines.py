# SPDX-License-Identifier: Apache-2.0
"""No name from the input speaks to the CI service that runs the command."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from multilica.snapshot import Snapshot
from multilica_cli.terminal import FoldingTable, answer_lines, stdout_console, without_commands
from tests.cli.support import Invoke, Outcome
from tests.ingest.support.recording_writers import make_snapshot, write_mcap
from tests.sinks.made_documents import made_document

NAME = "::error::rear"
EVIL = "::stop-commands::x ##[error]y ##vso[task.complete]z"


def commands(text: str) -> list[str]:
    """Return the lines that GitHub Actions or Azure Pipelines would obey."""
    return [line for line in text.splitlines() if line.strip().startswith("::") or re.search(r"##\w*\[", line)]


def assert_silent(outcome: Outcome) -> None:
    assert "error::" in outcome.out + outcome.err
    assert commands(outcome.out + outcome.err) == []


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two runs of a rig with a LiDAR of that name, which only the first places."""
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    paths = tmp_path / "complete.json", tmp_path / "partial.json"
    for path in paths:
        path.write_text(json.dumps(made_document(path.stem)).replace("rear", NAME))
    return paths


def test_commands_on_runs_speak_to_nobody(invoke: Invoke, runs: tuple[Path, Path]) -> None:
    complete, partial = runs
    for words in (
        ("check", complete, "--against", complete),
        ("check", partial, "--against", complete),
        ("check", partial, complete, "--against", complete),
        ("explain", complete),
        ("explain", partial),
        ("diff", complete, partial),
    ):
        assert_silent(invoke(*words))


def test_no_line_of_a_check_begins_with_a_name(invoke: Invoke, runs: tuple[Path, Path]) -> None:
    complete, partial = runs
    moved = json.loads(partial.read_text())
    moved["lidars"]["front left/1"]["T_target_source"][2][3] += 0.1
    partial.write_text(json.dumps(moved))
    for sources in ((partial,), (partial, complete)):
        outcome = invoke("check", *sources, "--against", complete)
        names = (*moved["lidars"], *map(str, sources))
        assert outcome.out.count(NAME) > 2
        assert [line for line in outcome.out.splitlines() if line.strip().startswith(names)] == []


def test_names_of_a_recording_speak_to_nobody(invoke: Invoke) -> None:
    first, second = make_snapshot().lidars
    odd = replace(first, name=NAME, frame_id=NAME, topic=EVIL)
    write_mcap(Snapshot((odd, second)), Path("odd.mcap"))
    assert_silent(invoke("inspect", "odd.mcap"))
    refusal = invoke("inspect", "odd.mcap", "--topic", EVIL.replace("x", "none"))
    assert refusal.code != 0
    assert commands(refusal.err) == []


def test_a_name_that_is_folded_or_follows_a_break_stays_silent(capsys: pytest.CaptureFixture[str]) -> None:
    console = stdout_console()
    console.width = 30
    table = FoldingTable("::group::title", ("LiDAR", "reason"), numbers_from=2)
    table.add_row("a" * 28 + "::error::x", f"b\n{EVIL}")
    table.add_row(EVIL, "c")
    console.print(table)
    console.print(f"a note\n  {EVIL}")
    printed = capsys.readouterr().out
    assert commands(printed) == []
    assert "\\x3a:stop-commands::x" in printed
    assert "\\x23#[error]" in printed


@pytest.mark.parametrize("text", ["ws://[::1]:8765/ a::b", "x: ::y", "# a ## b", "a #[b]"])
def test_other_colons_and_hashes_are_shown_as_they_are(text: str) -> None:
    assert without_commands(text) == text


def test_a_line_of_csv_that_begins_with_a_command_is_quoted() -> None:
    rows = [("::error::x", 1, None), ("front", 2, 0.5)]
    assert list(answer_lines(("lidar", "n", "x"), rows, "csv")) == [
        "lidar,n,x\n",
        '"::error::x","1",""\n',
        "front,2,0.5\n",
    ]
