# SPDX-License-Identifier: Apache-2.0
"""`multilica view` and `multilica report` on what a run left."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from multilica_cli import main
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence


@pytest.fixture(scope="module")
def saved_run(two_lidars: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "run"
    arguments = ("calibrate", two_lidars, "--out", folder, "--until", "preprocess", "--quiet")
    assert main.run([str(argument) for argument in arguments]) == ExitCode.DONE
    return folder


@pytest.fixture
def run(saved_run: Path, tmp_path: Path) -> Path:
    """A copy of that run in the directory of the test."""
    shutil.copytree(saved_run, tmp_path / "run")
    return Path("run")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viewer that draws at once."""
    monkeypatch.setattr("multilica.runs.run_report.viewer_picture", lambda *_: b"\x89PNG")


@pytest.mark.usefixtures("drawn")
def test_a_picture_is_written(invoke: Invoke, run: Path) -> None:
    outcome = invoke("view", run, "--png", "rig.png", "--width", 300, "--height", 200)
    assert (outcome.code, outcome.out, outcome.err) == (ExitCode.DONE, "wrote rig.png\n", "")
    assert Path("rig.png").read_bytes() == b"\x89PNG"


@pytest.mark.slow
def test_without_a_driver_the_package_is_named(invoke: Invoke, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, "nowhere.json")
    outcome = invoke("view", run, "--png", "rig.png")
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "mesa-vulkan-drivers" in outcome.err


def test_without_a_screen_the_way_out_is_named(invoke: Invoke, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    outcome = invoke("view", run)
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "--png" in outcome.err


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_report_is_made_anew_but_never_over_that_of_the_run(invoke: Invoke, run: Path) -> None:
    outcome = invoke("report", run)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "--out" in outcome.err
    assert invoke("report", run, "--out", "anew.html").out == "wrote anew.html\n"
    (run / "report.html").unlink()
    assert invoke("report", run).out == "wrote run/report.html\n"
    assert "stopped after stage preprocess" in (run / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        (["view", "nowhere"], ExitCode.INPUT, "nowhere"),
        (["report", "nowhere"], ExitCode.INPUT, "nowhere"),
        (["view", "run", "--png", "rig.png", "--width", "7"], ExitCode.USAGE, "64 to 8192"),
        (["report", "run", "--out", "run"], ExitCode.BROKEN, "run"),
        (["view", "run", "--png", "rig.jpg"], ExitCode.USAGE, "expected a name that ends in .png"),
    ],
)
@pytest.mark.usefixtures("run", "drawn")
def test_what_a_user_gets_wrong_is_one_sentence(
    arguments: list[str], code: ExitCode, named: str, invoke: Invoke
) -> None:
    outcome = invoke(*arguments)
    assert outcome.code == code
    assert named in outcome.err.splitlines()[-1]
    assert "Traceback" not in outcome.err
    assert not Path("rig.png").exists()
