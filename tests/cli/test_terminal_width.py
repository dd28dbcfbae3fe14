# SPDX-License-Identifier: Apache-2.0
"""What commands print on terminals of 80 and 120 columns."""

from __future__ import annotations

import io
import json
import re

import pytest
import typer.rich_utils  # noqa: F401 - reads at its import whether to force colours, for the whole process
from rich.cells import cell_len
from rich.console import Console

from multilica_cli.commands.demo import find_sample
from multilica_cli.main import app
from multilica_cli.tables.folding_table import FoldingTable
from multilica_cli.terminal import wrapped
from tests.runs.made_runs import write_run, write_truth
from tests.sinks.made_documents import made_document

_OFF = ((0.004, -0.123, 0.002), (0.01, -0.2, 0.03))
_WORD = re.compile(r"[^\s─│╭╮╰╯*•]+")
_COMMANDS = [name for command in app.registered_commands if (name := command.name or command.callback.__name__)]


@pytest.fixture
def shown(invoke, monkeypatch):
    """Lines of a command on a terminal of that width."""

    def run(width, *arguments):
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setenv("FORCE_COLOR", "1")
        done = invoke(*arguments)
        return re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", done.out + done.err).splitlines()

    return run


def _words(lines):
    return {word for line in lines for word in _WORD.findall(line)}


def _assert_fits(shown, *arguments):
    wide = _words(shown(1000, *arguments))
    for width in (80, 120):
        lines = shown(width, *arguments)
        assert lines
        too_long = [line for line in lines if cell_len(line.rstrip()) > width and len(line.split()) > 1]
        assert not too_long
        long = [word for word in wide if len(word) > width // 3]
        broken = {word for word in _words(lines) - wide if not any(word in each for each in long)}
        assert not broken


@pytest.fixture
def run_of(tmp_path):
    """Writes a run directory with a made result."""

    def write(outcome, names=None):
        document = made_document(outcome)
        if names is not None:
            entries = [*document["lidars"].values()]
            document["lidars"] = {"top": document["lidars"]["top"]}
            document["lidars"] |= {name: entries[index % 2] for index, name in enumerate(names)}
            document |= {"pairs": [], "decisions": [], "refinement": None, "stages": None}
        folder = tmp_path / outcome
        folder.mkdir()
        (folder / "result.json").write_text(json.dumps(document))
        return folder

    return write


@pytest.mark.parametrize("outcome", ["complete", "uncertain", "partial", "failed"])
def test_an_explanation_fits(shown, run_of, outcome):
    _assert_fits(shown, "explain", run_of(outcome))


@pytest.mark.parametrize(
    "names",
    [[f"lidar_{index:02}" for index in range(20)], ["sensor_at_the_front_left_corner_of_the_roof", "rear"]],
    ids=["twenty", "long"],
)
def test_many_lidars_and_long_names_fit(shown, run_of, names):
    folder = run_of("uncertain", names)
    _assert_fits(shown, "explain", folder)
    text = "\n".join(shown(80, "explain", folder))
    assert len(re.findall(r"-2\.000", text)) == len(names[1::2])


def test_comparisons_fit(shown, tmp_path):
    first = write_run(tmp_path / "first", {"left": _OFF, "rear": _OFF}, sigmas=(0.1, 0.02))
    second = write_run(tmp_path / "second", {"left": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "rear": None})
    truth = write_truth(tmp_path / "truth.toml")
    _assert_fits(shown, "diff", first, second)
    _assert_fits(shown, "evaluate", first, second, "--truth", truth)
    _assert_fits(shown, "evaluate", first, "--truth", truth, "--table", "paper")


@pytest.mark.parametrize(
    "arguments",
    [("inspect", find_sample().recording), ("config",), ("config", "--preset", "paper"), ("doctor",)],
    ids=["inspect", "config", "paper", "doctor"],
)
def test_tables_of_other_commands_fit(shown, arguments):
    _assert_fits(shown, *arguments)


@pytest.mark.parametrize("command", [*_COMMANDS, "fleet"])
def test_help_fits_and_flags_have_no_type(shown, command):
    _assert_fits(shown, command, "--help")
    assert "<bool>" not in "\n".join(shown(80, command, "--help"))


@pytest.mark.parametrize(
    "command", ["run", "query", "status", "failures", "show", "drift", "report", "compact", "prune"]
)
def test_help_of_the_fleet_fits(shown, command):
    _assert_fits(shown, "fleet", command, "--help")
    assert "<bool>" not in "\n".join(shown(80, "fleet", command, "--help"))


def test_an_error_fits(shown, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    _assert_fits(shown, "calibrate", "nowhere.mcap")


def _lines_of(table, width):
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def _table(columns, cells):
    table = FoldingTable("Title", ("LiDAR", *columns), spare=columns[-1:])
    table.add_row("front", *cells)
    table.add_row("rear", *cells)
    return table


def test_a_narrow_table_loses_gaps_then_what_is_spare():
    table = _table(("a", "b", "spare"), ("1.25", "2.25", "3.25"))
    lines = {width: _lines_of(table, width) for width in (40, 24, 20)}
    assert " front  1.25  2.25   3.25" in lines[40]
    assert " front 1.25 2.25  3.25" in lines[24]
    assert " front 1.25 2.25" in lines[20]
    assert "3.25" not in "".join(lines[20])


def test_a_table_that_is_too_wide_goes_on_below():
    columns = [f"c{index}" for index in range(6)]
    lines = _lines_of(_table(columns, [f"{index}.125" for index in range(6)]), 24)
    text = "\n".join(lines)
    assert max(map(len, lines)) <= 24
    assert all(f"{index}.125" in text for index in range(6))
    assert sum(line.startswith(" front") for line in lines) == 3
    assert text.count("Title") == 1


def test_text_ends_between_words_and_a_path_stays_whole():
    path = "/a/very/long/path/that/does/not/fit/on/a/line.toml"
    text = wrapped(f"  wrote the file {path} and more words", 30)
    assert path in text.splitlines()[1]
    assert all(line.startswith("    ") for line in text.splitlines()[1:])
    assert wrapped("short", 30) == "short"
