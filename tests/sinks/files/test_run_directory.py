# SPDX-License-Identifier: Apache-2.0
"""What a run leaves in its directory."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader

from multilica import events
from multilica.config import CalibrationConfig, load_config
from multilica.errors import UsageError
from multilica.results import Refusal
from multilica.sinks.files.result_files import ResultFiles
from multilica.sinks.mcap.messages import read_attached_document
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.rerun.reading import read_recorded_document
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_directory import open_run
from tests.sinks.made_events import made_events

NAMES = {"calibration.toml", "result.json", "report.html", "recording.rrd", "result.mcap", "config.toml"}
CONFIG = CalibrationConfig(target="top", fine={"max_iterations": 7})


def run_into(directory, stop_after: int | None = None):
    with open_run(directory, CONFIG) as run:
        for event in list(made_events())[:stop_after]:
            run(event)
    return run


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The directory of a whole run, which tests read or copy."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    run_into(directory)
    return directory


def lay(finished, directory):
    shutil.copytree(finished, directory, dirs_exist_ok=True)


@pytest.mark.slow
def test_a_finished_run_leaves_every_file_and_nothing_else(tmp_path):
    run = run_into(tmp_path / "deep" / "run")
    names = ["calibration.toml", "result.json", "report.html", "recording.rrd", "result.mcap", "config.toml"]
    assert [path.name for path in run.written] == names
    assert {path.name for path in (tmp_path / "deep" / "run").iterdir()} == set(names)


@pytest.mark.slow
def test_the_mcap_file_holds_what_the_others_wrote(finished):
    with (finished / "result.mcap").open("rb") as file:
        attached = {one.name: one.data for one in make_reader(file).iter_attachments()}
    for name in ("calibration.toml", "result.json", "report.html"):
        assert attached[name] == (finished / name).read_bytes()


@pytest.mark.slow
@pytest.mark.in_turn
def test_sinks_that_share_a_state_tell_what_each_tells_alone(finished, tmp_path):
    shared, alone = finished, tmp_path
    sinks = (RerunRecording(alone / "recording.rrd"), ResultMcap(alone / "result.mcap"), ResultFiles(alone))
    with ExitStack() as stack:
        for sink in sinks[:-1]:
            stack.enter_context(sink)
        for event in made_events():
            for sink in sinks:
                sink(event)
    documents = [json.loads((folder / "result.json").read_text()) for folder in (shared, alone)]
    assert documents[0] == documents[1]
    assert read_attached_document(shared / "result.mcap") == read_attached_document(alone / "result.mcap")
    assert read_recorded_document(shared / "recording.rrd") == read_recorded_document(alone / "recording.rrd")


@pytest.mark.slow
def test_what_a_sink_was_not_told_it_does_not_take_for_done(tmp_path, monkeypatch):
    def no_space(*_):
        raise OSError("no space left")

    monkeypatch.setattr("multilica.sinks.rerun.recording.log_outcome", no_space)
    with pytest.raises(OSError, match="no space left"):
        run_into(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names.isdisjoint({"result.json", "calibration.toml", "result.mcap"})
    report = (tmp_path / "report.html").read_text()
    assert "ended early" in report
    assert "no space left" in report


@pytest.mark.slow
def test_the_resolved_configuration_can_be_given_back(finished):
    assert load_config(finished / "config.toml") == CONFIG


def files_in(directory):
    return {path.relative_to(directory): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_an_earlier_result_stays_until_the_new_one_is_whole(finished, tmp_path):
    lay(finished, tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    before = files_in(tmp_path)
    run = run_into(tmp_path, stop_after=8)
    unfinished = tmp_path / "unfinished"
    names = ["report.html", "recording.partial.rrd", "result.partial.mcap", "config.toml"]
    assert list(run.written) == [unfinished / name for name in names]
    assert {path: data for path, data in files_in(tmp_path).items() if path.parts[0] != "unfinished"} == before
    run = run_into(tmp_path)
    assert not unfinished.exists()
    assert {path.name for path in run.written} | {"notes.txt"} == {path.name for path in tmp_path.iterdir()}
    assert (tmp_path / "recording.rrd").read_bytes() != before[Path("recording.rrd")]
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_files_of_an_unfinished_run_are_removed(tmp_path):
    run_into(tmp_path, stop_after=8)
    assert (tmp_path / "recording.partial.rrd").exists()
    run_into(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == NAMES


@pytest.mark.slow
def test_what_a_killed_run_was_writing_goes_with_it(tmp_path):
    begun = tmp_path / ".result.partial.mcap.4711.tmp"
    begun.write_bytes(b"half")
    run_into(tmp_path)
    assert not begun.exists()


@pytest.mark.slow
def test_a_run_that_never_started_leaves_an_earlier_one_alone(finished, tmp_path):
    lay(finished, tmp_path)
    before = files_in(tmp_path)
    assert {*run_into(tmp_path, stop_after=0).written} == {tmp_path / name for name in NAMES}
    assert files_in(tmp_path) == before


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("moved", range(8))
def test_the_next_run_finishes_a_replacement_that_was_killed(finished, tmp_path, monkeypatch, moved):
    lay(finished, tmp_path)
    replace, left = Path.replace, iter(range(moved))

    def replace_some(path, target):
        if path.parent.name == "unfinished" and not path.name.startswith(".") and next(left, None) is None:
            raise SystemExit
        return replace(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace_some)
        if moved < 7:
            with pytest.raises(SystemExit):
                run_into(tmp_path)
        else:
            run_into(tmp_path)
    with pytest.raises(ValueError, match="nothing more"), open_run(tmp_path, CONFIG):
        raise ValueError("nothing more")
    assert {path.name for path in tmp_path.iterdir()} == NAMES


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("listed", ['["../mine.txt", "config.toml"]', "not JSON", "7", "[1]"])
def test_a_list_that_no_run_wrote_moves_nothing_else(finished, tmp_path, listed):
    lay(finished, tmp_path / "run")
    run_into(tmp_path / "run", stop_after=8)
    (tmp_path / "run" / "mine.txt").write_text("mine")
    (tmp_path / "run" / "unfinished" / ".whole.json").write_text(listed)
    run_into(tmp_path / "run")
    assert {path.name for path in (tmp_path / "run").iterdir()} == NAMES | {"mine.txt"}
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_entry_of_the_users_own_is_not_overwritten(tmp_path):
    (tmp_path / "unfinished").mkdir()
    (tmp_path / "unfinished" / "chapter.txt").write_text("mine")
    with pytest.raises(UsageError, match="its 'unfinished' is not of a multilica run"):
        run_into(tmp_path)
    assert (tmp_path / "unfinished" / "chapter.txt").read_text() == "mine"


def lay_snapshots(finished, directory, names, is_refused=False):
    """An earlier joint run, whose result names snapshots with directories of their own."""
    lay(finished, directory)
    result = json.loads((directory / "result.json").read_text())
    result["snapshots"] = [{"name": name} for name in names]
    result["refusal"] = {"code": "few"} if is_refused else None
    (directory / "result.json").write_text(json.dumps(result))


@pytest.mark.slow
@pytest.mark.parametrize("is_refused", [False, True])
def test_snapshots_of_an_earlier_run_go_with_it(finished, tmp_path, is_refused):
    run, mine = tmp_path / "run", tmp_path / "run" / "mine"
    lay_snapshots(finished, run, ["stop_1", "stop_2", "mine"], is_refused)
    lay(finished, run / "stop_1")
    lay(finished, run / "stop_2")
    mine.mkdir()
    run_into(run)
    assert {path.name for path in run.iterdir()} == NAMES | {"mine"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["..", "../other", "/", "", 7, "link"])
def test_a_snapshot_elsewhere_is_not_removed(finished, tmp_path, name):
    lay(finished, tmp_path)
    lay(finished, tmp_path / "other")
    before = files_in(tmp_path)
    lay_snapshots(finished, tmp_path / "run", [name])
    (tmp_path / "run" / "link").symlink_to(tmp_path / "other")
    run_into(tmp_path / "run")
    assert {path: data for path, data in files_in(tmp_path).items() if path.parts[0] != "run"} == before


@pytest.mark.slow
def test_a_second_run_in_the_same_directory_is_refused(tmp_path):
    with open_run(tmp_path, CONFIG), pytest.raises(UsageError, match="Another multilica run is writing to"):
        run_into(tmp_path)
    assert run_into(tmp_path).written


def refuse_into(directory):
    """A run whose snapshot is refused in stage preprocess."""
    told = list(made_events("failed"))
    refusal = Refusal("moving_vehicle", "The vehicle moves.")
    with open_run(directory, CONFIG) as run:
        for event in [*told[:5], events.CalibrationFinished(replace(told[-1].result, refusal=refusal))]:
            run(event)
    return run


def test_a_refused_snapshot_leaves_every_file(tmp_path):
    assert refuse_into(tmp_path).started
    assert {path.name for path in tmp_path.iterdir()} == NAMES
    assert json.loads((tmp_path / "result.json").read_text())["refusal"]["code"] == "moving_vehicle"


@pytest.mark.slow
def test_a_refused_snapshot_leaves_an_earlier_result_alone(finished, tmp_path):
    lay(finished, tmp_path)
    before = files_in(tmp_path)
    run = refuse_into(tmp_path)
    assert json.loads((tmp_path / "unfinished" / "result.json").read_text())["refusal"]["code"] == "moving_vehicle"
    assert {path.parent.name for path in run.written} == {"unfinished"}
    assert {path: data for path, data in files_in(tmp_path).items() if path.parts[0] != "unfinished"} == before


@pytest.mark.slow
def test_an_earlier_refusal_is_no_result_to_keep(tmp_path):
    refuse_into(tmp_path)
    assert refuse_into(tmp_path).started
    run_into(tmp_path)
    assert json.loads((tmp_path / "result.json").read_text())["refusal"] is None


def test_a_file_in_the_way_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(UsageError, match=r"^Cannot write to .*out: File exists; give --out a directory") as refusal:
        run_into(tmp_path / "out")
    assert str(refusal.value).count(". ") == 0


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_directory_without_permission_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(UsageError, match="permission denied"):
        run_into(tmp_path)


def test_a_config_of_the_users_own_is_not_overwritten(tmp_path):
    (tmp_path / "config.toml").write_text('preset = "paper"\n')
    with pytest.raises(UsageError, match=r"its config\.toml is not of a multilica run"):
        run_into(tmp_path)
    assert (tmp_path / "config.toml").read_text() == 'preset = "paper"\n'


def test_importing_the_package_loads_neither_rerun_nor_mcap():
    code = "import sys, multilica.sinks; sys.exit(not {'rerun', 'mcap', 'foxglove', 'numpy'}.isdisjoint(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
