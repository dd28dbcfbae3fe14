# SPDX-License-Identifier: Apache-2.0
"""What commands print on terminals of 80 and 120 columns."""

from __future__ import annotations

import io
import json
import re
from types import SimpleNamespace

import pytest
import typer.rich_utils  # noqa: F401 - reads at its import whether to force colours, for the whole process
from rich.cells import cell_len
from rich.console import Console

from multilica import checks
from multilica.config import preset, with_overrides
from multilica.fleet.fleet_run import FleetOutcome
from multilica.fleet.store.records import LogRow
from multilica.run import run_calibration
from multilica.runs import run_report
from multilica.sinks.report import page
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.commands.fleet import fleet
from multilica_cli.main import app
from multilica_cli.progress import show_fleet
from multilica_cli.terminal import FoldingTable, wrapped
from tests.fleet.support.made_store import made_store
from tests.runs.made_runs import write_run, write_truth
from tests.sinks.made_documents import made_document

_OFF = ((0.004, -0.123, 0.002), (0.01, -0.2, 0.03))
_CODES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_WORD = re.compile(r"[^\s─│╭╮╰╯*•]+")
_SAMPLE = find_sample()


def _names_of(commands):
    return [command.name or command.callback.__name__ for command in commands.registered_commands]


@pytest.fixture
def shown(invoke, monkeypatch):
    """Lines of a command on a terminal of that width."""

    def run(width, *arguments):
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setenv("FORCE_COLOR", "1")
        done = invoke(*arguments)
        return _CODES.sub("", done.out + done.err).splitlines()

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
        long = [word for word in wide if len(word) > 2 * width // 3]
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


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [("inspect", _SAMPLE.recording), ("config",), ("config", "--preset", "paper"), ("doctor",)],
    ids=["inspect", "config", "paper", "doctor"],
)
def test_tables_of_other_commands_fit(shown, arguments, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=5e9))  # it changes between two calls
    _assert_fits(shown, *arguments)


@pytest.mark.parametrize(
    "command",
    [(), ("fleet",), *((name,) for name in _names_of(app)), *(("fleet", name) for name in _names_of(fleet))],
    ids=" ".join,
)
def test_help_fits_and_flags_have_no_type(shown, command):
    _assert_fits(shown, *command, "--help")
    assert "<bool>" not in "\n".join(shown(80, *command, "--help"))


@pytest.fixture(scope="module")
def calibrated(two_lidars, tmp_path_factory):
    """A run of two LiDARs of the sample."""
    config = with_overrides(preset("default"), ["target=left"])
    return run_calibration(two_lidars, tmp_path_factory.mktemp("runs") / "street", config)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [("calibrate", _SAMPLE.recording, "--workers", "1"), ("demo",)], ids=lambda it: it[0]
)
def test_the_end_of_a_calibration_fits(shown, calibrated, command, monkeypatch):
    monkeypatch.setattr("multilica.run.run_calibration", lambda *_, **__: calibrated)
    _assert_fits(shown, *command)
    assert any("right" in line and "placed" in line for line in shown(80, *command))


def _once(function):
    """Keep the first result, whatever the arguments."""
    results = []

    def call(*arguments):
        results.extend([] if results else [function(*arguments)])
        return results[0]

    return call


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "RUN", "--against", _SAMPLE.truth),
        ("verify", _SAMPLE.recording, "--calibration", _SAMPLE.truth),
        ("accept", "RUN", "--into", "reference.toml"),
        ("export", "RUN", "--to", "urdf", "--out", "rig.urdf"),
        ("record", _SAMPLE.recording, "--out", "taken.mcap"),
        ("evaluate", "RUN", "--truth", _SAMPLE.truth),
        ("diff", "RUN", _SAMPLE.truth),
        ("report", "RUN", "--out", "page.html"),
    ],
    ids=lambda it: it[0],
)
def test_commands_on_runs_fit(shown, calibrated, arguments, monkeypatch):
    """The work of a command is done once for all widths."""
    given = [calibrated.directory if each == "RUN" else each for each in arguments]
    for module, name in ((checks, "verify_stops"), (run_report, "contents_of_run"), (page, "report_html")):
        monkeypatch.setattr(module, name, _once(getattr(module, name)))
    if arguments[0] == "accept":
        shown(80, *given)  # it compares with the file that it wrote before
    _assert_fits(shown, *given)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet") / "store"
    made_store(folder)
    return folder


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    "question",
    [
        ("status",),
        ("failures",),
        ("show", "v02"),
        ("drift",),
        ("query", "SELECT * FROM lidars ORDER BY ALL LIMIT 3"),
        ("prune",),
    ],
    ids=lambda it: it[0],
)
def test_answers_of_the_fleet_fit(shown, store, question):
    _assert_fits(shown, "fleet", *question, "--store", store)


def test_each_row_that_goes_on_below_names_its_lidar(shown, store):
    rows = [line for line in shown(80, "fleet", "show", "v02", "--store", store) if line.startswith(" 2026-")]
    assert len(rows) == 3 * 30
    assert all(row.split()[2] in ("front", "rear", "top") for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("width", [80, 120])
def test_progress_of_the_fleet_fits(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("FORCE_COLOR", "1")
    told = "the file is damaged near its end and cannot be read any further than its first chunk"
    row = LogRow(
        "k", "truck-0123456789", 0, "s3://bucket/truck/2026-03-01.mcap", "f", 1, "failed", "damaged", reason_text=told
    )
    with show_fleet(quiet=False) as observe:
        observe(FleetOutcome(12_000))
        for _ in range(300):
            observe(row)
    text = _CODES.sub("", capsys.readouterr().err)
    assert max(map(cell_len, text.splitlines())) <= width
    assert set(told.split()) <= set(text.split())
    assert "300/12000" in text


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


@pytest.mark.parametrize("width", [80, 120])
def test_topics_stay_whole(width):
    columns = ("LiDAR", "topic", "type", "frame", "scans", "Hz")
    table = FoldingTable("Topics", columns, numbers_from=4, keys=2)
    topics = [f"/sensing/lidar/{name}/pointcloud_raw_ex" for name in ("front_lower", "rear_upper")]
    for topic in topics:
        name = topic.split("/")[3]
        table.add_row(name, topic, "PointCloud2", f"{name}/base_link", "10", "10.0")
    lines = _lines_of(table, width)
    assert max(map(len, lines)) <= width
    assert {"front_lower", "rear_upper", "front_lower/base_link", *topics} <= _words(lines)


def test_the_widest_name_is_broken_where_no_column_fits():
    table = FoldingTable("Names", ("run", "LiDAR", "x"), numbers_from=2, keys=2)
    table.add_row("a" * 70, "front", "-123.456")
    lines = _lines_of(table, 40)
    assert max(map(len, lines)) <= 40
    assert {"front", "-123.456"} <= _words(lines)


def test_text_ends_between_words_and_a_path_stays_whole():
    path = "/a/very/long/path/that/does/not/fit/on/a/line.toml"
    text = wrapped(f"  wrote the file {path} and more words", 30)
    assert path in text.splitlines()[1]
    assert all(line.startswith("    ") for line in text.splitlines()[1:])
    assert wrapped("short", 30) == "short"
