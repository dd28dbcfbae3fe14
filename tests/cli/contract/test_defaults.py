# SPDX-License-Identifier: Apache-2.0
"""Defaults of every option, as a table, and what they mean at their limits."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import typer

from multilica.config import CalibrationConfig, preset
from multilica_cli.exit_codes import ExitCode
from multilica_cli.main import app
from multilica_cli.options import Parameters
from tests.cli.support import Invoke
from tests.runs.made_runs import write_run, write_truth
from tests.sinks.made_documents import made_document

READING = dict.fromkeys(("--topic", "--frames", "--start", "--window", "--duration")) | {"--strict": False}
RESOLVING = dict.fromkeys(("--preset", "--config", "--set"))
TOLERANCES = {"--max-translation": 0.03, "--max-rotation": 0.3}
CHECKING = dict.fromkeys(
    (
        *("--tolerances", "--junit", "--summary", "--code-quality"),
        *("--topic", "--frames", "--config", "--set", "--max-time"),
    )
)
DEFAULTS = {
    "check": {
        **dict.fromkeys(("RUN|SOURCE", "--against", "--out", "--workers", "--stops")),
        **TOLERANCES,
        **CHECKING,
        "--quiet": False,
        "--json": False,
    },
    "verify": {
        **dict.fromkeys(("SOURCE", "--calibration", "--stops")),
        **TOLERANCES,
        **CHECKING,
        "--quiet": False,
        "--json": False,
    },
    "accept": {**dict.fromkeys(("RUN", "--into")), **TOLERANCES, "--quiet": False},
    "calibrate": {
        **dict.fromkeys(("SOURCE", "--target", "--out", "--prior", "--max-sigma", "--until", "--workers", "--record")),
        **dict.fromkeys(("--base", "--rig", "--max-time", "--timeout", "--stops")),
        **READING,
        **RESOLVING,
        "--ground": False,
        "--mcap-encoding": "foxglove",
        "--quiet": False,
        "--json": False,
    },
    "inspect": {"SOURCE": None, "--timeout": None, **READING, "--json": False},
    "record": {
        **dict.fromkeys(("SOURCE", "--out", "--timeout", "--stops")),
        **READING,
        "--vehicle": "",
        "--quiet": False,
        "--json": False,
    },
    "explain": {"RUN": None, "--json": False},
    "query": {"RUN": None, "TABLE": None, "--format": None, "--out": None},
    "diff": {"RUN_A": None, "RUN_B": None, "--within-m": 1e-4, "--within-deg": 1e-3, "--json": False},
    "view": {"RUN": None, "--png": None, "--width": 1600, "--height": 900, "--quiet": False},
    "report": {"RUN": None, "--out": None, "--quiet": False},
    "config": {**RESOLVING, "--json": False, "--toml": False, "--markdown": False},
    "simulate": {
        **dict.fromkeys(
            ("--rig", "--scene", "--out", "--build-seed", "--disturb", "--sensors", "--frames", "--keep-every")
        ),
        **dict.fromkeys(("--drive", "--stops", "--parked", "--fleet", "--vehicles", "--logs", "--workers")),
        "--seed": 0,
    },
    "evaluate": {
        **dict.fromkeys(("RUN", "--truth", "--out", "--table")),
        "--within-m": 0.02,
        "--within-deg": 0.1,
        "--wrong-m": 0.05,
        "--wrong-deg": 0.5,
        "--wrong-sigma": 4.0,
        "--quiet": False,
        "--json": False,
    },
    "export": {
        **dict.fromkeys(("RUN", "--to", "--out", "--base", "--rig")),
        "--frames": "names",
        "--with-uncertain": False,
        "--quiet": False,
    },
    "datasets": {
        **dict.fromkeys(("NAME", "PATH", "--out", "--preset", "--target", "--topic", "--truth", "--set")),
        "--scenes": 10,
        "--frames": 5,
        "--within-m": 0.02,
        "--within-deg": 0.1,
        "--quiet": False,
        "--json": False,
    },
    "doctor": {"--json": False},
    "watch": {
        **dict.fromkeys(("SOURCE", "--calibration", "--tolerances", "--topic", "--frames", "--config", "--set")),
        **dict.fromkeys(("--max-time", "--store", "--metrics")),
        **TOLERANCES,
        "--interval": 60.0,
        "--timeout": 10.0,
        "--vehicle": "vehicle",
        "--quiet": False,
    },
    "publish": {
        **dict.fromkeys(("RUN", "[ros2://]", "--ws", "--base", "--rig")),
        "--frames": "ids",
        "--with-uncertain": False,
        "--quiet": False,
    },
    "demo": {"--out": Path("recordings/runs/demo"), "--quiet": False},
    "fleet run": {
        **dict.fromkeys(
            ("LOGS", "--out", "--pattern", "--target", "--workers", "--topic", "--frames", "--config", "--set")
        ),
        **dict.fromkeys(("--stops", "--window")),
        "--calibrate": "when-needed",
        "--max-translation": 0.03,
        "--max-rotation": 0.3,
        "--scheduler": "",
        "--max-log-time": 600.0,
        "--max-log-memory": 4000.0,
        "--retries": 5,
        "--newest-first": False,
        "--quiet": False,
        "--json": False,
    },
    "fleet query": {**dict.fromkeys(("SQL", "--store")), "--format": "table"},
    "fleet status": {"--store": None, "--format": "table"},
    "fleet failures": {"--store": None, "--format": "table"},
    "fleet show": {**dict.fromkeys(("VEHICLE", "--store")), "--format": "table"},
    "fleet drift": {**dict.fromkeys(("--store", "--nominal")), "--false-alarm-rate": 0.001, "--json": False},
    "fleet report": {"--store": None, "--out": Path("fleet-report.html"), "--nominal": None, "--quiet": False},
    "fleet prune": {"--store": None, "--successes": 30.0, "--failures": 365.0, "--quiet": False},
    "fleet browse": {**dict.fromkeys(("--store", "--vehicle")), "--host": "127.0.0.1", "--port": 51234},
    "fleet compact": {"--store": None, "--quiet": False},
    "fleet repair": {"--store": None, "--quiet": False},
}


def options_of(command):
    """Default by the long name of an option, or the metavar of an argument."""
    return {
        next((name for name in option.opts if name.startswith("--")), option.metavar or option.name): option.default
        for option in command.params
        if option.name != "help"
    }


def test_every_option_has_its_default():
    commands = typer.main.get_command(app).commands
    found = {name: options_of(command) for name, command in commands.items() if name != "fleet"}
    found |= {f"fleet {name}": options_of(command) for name, command in commands["fleet"].commands.items()}
    assert found == DEFAULTS


def test_options_without_a_default_leave_the_preset_as_it_is():
    assert Parameters().resolve(dict.fromkeys(("target", "runtime.workers"))) == preset("default")


def test_the_help_shows_the_defaults_of_the_configuration(invoke: Invoke):
    help_text = " ".join(invoke("calibrate", "--help").out.replace("│", " ").split())
    config = CalibrationConfig()
    sigma = f"{1000.0 * config.acceptance.max_sigma_m:g},{config.acceptance.max_sigma_deg:g}"
    shown = (f"({config.ingest.frames};", f"({sigma})]", f"({config.record.detail})]")
    assert [default for default in shown if f"[default: {default}" not in help_text] == []


SHIFT = (0.6, 0.0, 0.8)


def moved_document(shift_m: float, turn_deg: float) -> dict[str, object]:
    """A run whose rear LiDAR lies elsewhere, turned about z of the target."""
    document = made_document()
    matrix = document["lidars"]["rear"]["T_target_source"]
    cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    (x_row, y_row) = ([*matrix[0]], [*matrix[1]])
    for column in range(3):
        matrix[0][column] = cos * x_row[column] - sin * y_row[column]
        matrix[1][column] = sin * x_row[column] + cos * y_row[column]
    for axis in range(3):
        matrix[axis][3] += shift_m * SHIFT[axis]
    return document


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "code"),
    [
        (0.0, 0.0, ExitCode.DONE),
        (0.9e-4, 0.0, ExitCode.DONE),
        (1.1e-4, 0.0, ExitCode.DIFFERENT),
        (0.0, 0.9e-3, ExitCode.DONE),
        (0.0, 1.1e-3, ExitCode.DIFFERENT),
        (0.9e-4, 0.9e-3, ExitCode.DONE),
    ],
)
def test_diff_tells_moves_of_a_tenth_of_a_millimetre(shift_m, turn_deg, code, invoke: Invoke):
    for name, document in (("a", made_document()), ("b", moved_document(shift_m, turn_deg))):
        Path(f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    assert invoke("diff", "a.json", "b.json").code == code
    assert invoke("diff", "a.json", "b.json", "--within-m", "1e-9", "--within-deg", "1").code == (
        ExitCode.DIFFERENT if shift_m else ExitCode.DONE
    )
    assert invoke("diff", "a.json", "b.json", "--within-m", "1", "--within-deg", "1e-9").code == (
        ExitCode.DIFFERENT if turn_deg else ExitCode.DONE
    )


def test_a_run_is_the_same_as_itself_with_limits_of_zero(invoke: Invoke):
    Path("a.json").write_text(json.dumps(made_document()), encoding="utf-8")
    assert invoke("diff", "a.json", "a.json", "--within-m", "0", "--within-deg", "0").code == ExitCode.DONE


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "outcome"),
    [
        (0.019, 0.09, "within"),
        (0.021, 0.0, "between"),
        (0.0, 0.11, "between"),
        (0.049, 0.49, "between"),
        (0.051, 0.0, "false_accept"),
        (0.0, 0.51, "false_accept"),
    ],
)
def test_evaluate_counts_errors_by_its_limits(shift_m, turn_deg, outcome, invoke: Invoke):
    write_truth(Path("t.toml"))
    write_run(Path("run"), {"left": ((0.0, shift_m, 0.0), (turn_deg, 0.0, 0.0))})
    document = json.loads(invoke("evaluate", "run", "--truth", "t.toml", "--json").out)
    overall = document["overall"]
    assert {name for name in ("within", "between", "false_accept") if overall[name]} == {outcome}
