# SPDX-License-Identifier: Apache-2.0
"""Calibration from recordings to a run directory, without the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import multilica
from multilica import events
from multilica.config import with_overrides
from multilica.errors import MissingDependencyError, UnfitSnapshotError, UsageError
from multilica.run import default_directory
from multilica.sinks.mcap.messages import read_attached_document
from multilica.sinks.rerun.reading import read_recorded_document
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.sinks.recording_reader import Recording

SAMPLE = Path(__file__).parents[2] / "recordings" / "samples" / "edgar-street.mcap"
FILES = {"calibration.toml", "config.toml", "recording.rrd", "report.html", "result.json", "result.mcap"}
FAST = with_overrides(multilica.preset("default"), ["fine.max_finalists=2", "target=right"])
EARLY = with_overrides(FAST, ["until=preprocess"])


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two snapshots of two LiDARs of the sample, others of a single LiDAR, none, and a moving vehicle."""
    folder = tmp_path_factory.mktemp("recordings")
    sample = multilica.read_snapshot(SAMPLE)
    first, second = (
        {name: [sample[name].scans[frame].points_m[::2]] for name in ("left", "right")} for frame in (0, 1)
    )
    shift_m = np.array([0.4, 0.0, 0.0], np.float32)
    moving = {name: [clouds[0] - index * shift_m for index in range(3)] for name, clouds in first.items()}
    alone = {"right": first["right"]}
    for name, lidars in {"first": first, "second": second, "moving": moving, "alone": alone, "nothing": {}}.items():
        write_recording(folder / f"{name}.mcap", lidars)
    return folder


def write_recording(path: Path, lidars: dict[str, list[np.ndarray]]) -> None:
    scans = {
        name: tuple(Scan(cloud, 1 + 100_000_000 * index) for index, cloud in enumerate(clouds))
        for name, clouds in lidars.items()
    }
    write_snapshot_mcap(Snapshot(tuple(LidarScans(name, own, topic=f"/{name}") for name, own in scans.items())), path)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def files_that_name(folder: Path, runs: Path) -> set[str]:
    """The files of runs that hold the path of a folder, compressed or not."""
    path = str(folder).encode()
    found = {str(file) for file in runs.rglob("*.*") if file.is_file() and path in file.read_bytes()}
    for file in runs.rglob("*.rrd"):
        columns = [column for chunk in Recording(file).chunks for column in chunk.to_record_batch().columns]
        if any(each and path in each.to_pybytes() for column in columns for each in column.buffers()):
            found.add(str(file))
    return found


@pytest.mark.slow
def test_no_file_of_a_run_names_a_folder_of_the_machine(tmp_path: Path) -> None:
    cut = tmp_path / "logs" / "cut.mcap"
    cut.parent.mkdir()
    cut.write_bytes(SAMPLE.read_bytes()[:-5000])
    run = multilica.run_calibration(cut, tmp_path / "run", with_overrides(EARLY, ["ingest.frames=1"]))
    document = json.loads((run.directory / "result.json").read_text())
    assert document["input"]["source"] == "cut.mcap"
    assert any("cut.mcap is damaged" in note for note in document["input"]["notes"])
    assert files_that_name(cut.parent, tmp_path / "run") == set()
    assert "cut.mcap" in (run.directory / "report.html").read_text()
    assert Recording(run.directory / "recording.rrd").properties()["input_source"] == "cut.mcap"


@pytest.mark.slow
def test_a_recording_becomes_a_run_directory(recordings: Path, tmp_path: Path) -> None:
    seen: list[events.RunEvent] = []
    run = multilica.run_calibration(recordings / "first.mcap", tmp_path / "run", FAST, observe=seen.append)
    assert {path.name for path in run.written} == names(tmp_path / "run") == FILES
    assert run.directory == tmp_path / "run"
    snapshot = multilica.read_snapshot(recordings / "first.mcap", config=FAST.ingest)
    expected = multilica.calibrate(snapshot, FAST)["left"].T_target_source
    np.testing.assert_array_equal(run.result["left"].T_target_source.matrix, expected.matrix)
    written = multilica.read_extrinsics(run.written[0]).between("right", "left")
    np.testing.assert_allclose(written.matrix, expected.matrix, atol=1e-6)
    started = [event.stage for event in seen if isinstance(event, events.StageStarted)]
    assert started[:2] == ["ingest", "preprocess"]
    assert isinstance(seen[-1], events.CalibrationFinished)


@pytest.mark.slow
@pytest.mark.in_turn
def test_snapshots_of_one_rig_give_a_joint_result(recordings: Path, tmp_path: Path) -> None:
    seen: list[events.RunEvent] = []
    given = "first", "alone", "second", "nothing"
    sources = [str(recordings / f"{name}.mcap") for name in given]
    run = multilica.run_calibration(sources, tmp_path, FAST, observe=seen.append)
    assert names(tmp_path) == FILES | {"first", "second"}
    assert {path.name for path in run.written} == names(tmp_path)
    assert names(tmp_path / "first") == names(tmp_path / "second") == FILES
    assert [bool(report.refusal) for report in run.result.snapshots] == [False, True, False, True]
    assert [event.name for event in seen if isinstance(event, events.SnapshotStarted)] == [*given]
    refused = {event.name: event.reason for event in seen if isinstance(event, events.SnapshotRefused)}
    assert {*refused} == {"alone", "nothing"}
    assert "only one LiDAR" in refused["alone"]
    assert "holds no point clouds" in refused["nothing"]
    assert [report.source for report in run.result.snapshots] == [f"{name}.mcap" for name in given]
    assert files_that_name(recordings, tmp_path) == set()
    assert run.result["left"].placed


@pytest.mark.slow
def test_a_prior_is_tried_and_its_gaps_are_noted(tmp_path: Path) -> None:
    seen: list[events.RunEvent] = []
    truth = SAMPLE.with_suffix(".truth.toml")
    poses = multilica.read_extrinsics(truth)
    gap = tmp_path / "gap.toml"
    lines = truth.read_text(encoding="utf-8").replace("rear", "other")
    gap.write_text(lines, encoding="utf-8")
    config = with_overrides(EARLY, ["ingest.frames=1"])
    run = multilica.run_calibration(SAMPLE, tmp_path / "run", config, prior=str(gap), observe=seen.append)
    deviation = run.result["left"].T_target_source_prior
    assert deviation.distance_to(poses.between("right", "left"))[0] < 1e-6
    notes = [event.note for event in seen if isinstance(event, events.InputNoted)]
    assert any("has no pose of rear" in note for note in notes)


def test_an_unfit_source_leaves_no_directory(recordings: Path, tmp_path: Path) -> None:
    with pytest.raises(UnfitSnapshotError, match="only one LiDAR"):
        multilica.run_calibration(recordings / "alone.mcap", tmp_path / "run", FAST.model_copy(update={"target": ""}))
    with pytest.raises(UsageError, match="No source"):
        multilica.run_calibration([], tmp_path / "run")
    assert names(tmp_path) == set()


@pytest.mark.slow
def test_a_refused_snapshot_says_where_to_look(recordings: Path, tmp_path: Path) -> None:
    with pytest.raises(UnfitSnapshotError, match="moves") as caught:
        multilica.run_calibration(recordings / "moving.mcap", tmp_path / "run", EARLY)
    assert f"`multilica explain {tmp_path / 'run'}`" in caught.value.__notes__[0]
    assert json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))["refusal"]


@pytest.mark.slow
def test_a_refused_snapshot_leaves_an_earlier_run(recordings: Path, tmp_path: Path) -> None:
    multilica.run_calibration(recordings / "first.mcap", tmp_path, EARLY)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(UnfitSnapshotError) as caught:
        multilica.run_calibration(recordings / "moving.mcap", tmp_path, EARLY)
    assert caught.value.__notes__[0] == f"The earlier result in {tmp_path} is unchanged."
    assert f"see `multilica explain {tmp_path / 'unfinished'}`" in caught.value.__notes__[1]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.slow
def test_an_interrupted_run_keeps_its_recording(recordings: Path, tmp_path: Path) -> None:
    def interrupt(event: events.RunEvent) -> None:
        if isinstance(event, events.StageFinished) and event.stage == "features":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        multilica.run_calibration(recordings / "first.mcap", tmp_path, FAST, observe=interrupt)
    assert str(tmp_path) in caught.value.__notes__[0]
    assert names(tmp_path) == {"config.toml", "recording.partial.rrd", "report.html", "result.partial.mcap"}


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_stage_is_told_when_it_is_in_the_files(recordings: Path, tmp_path: Path) -> None:
    """Stages that search pairs end together, and are written with the last one."""
    told: list[str] = []

    def observe(event: events.RunEvent) -> None:
        if isinstance(event, events.StageFinished) and event.stage == "correspond":
            told.extend(read_recorded_document(tmp_path / "recording.partial.rrd").progress.finished)
            told.extend(read_attached_document(tmp_path / "result.partial.mcap").progress.finished)

    until_fine = with_overrides(FAST, ["until=fine"])
    multilica.run_calibration(recordings / "first.mcap", tmp_path, until_fine, observe=observe)
    assert told.count("correspond") == told.count("fine") == 2


@pytest.mark.slow
def test_without_a_configuration_all_frames_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(event: events.RunEvent) -> None:
        if isinstance(event, events.CalibrationStarted):
            raise InterruptedError(event.config.ingest.frames)

    monkeypatch.chdir(tmp_path)
    snapshot = multilica.read_snapshot(SAMPLE)
    write_snapshot_mcap(snapshot, tmp_path / "taken.mcap", metadata={"frames": "12"})
    with pytest.raises(InterruptedError, match="12"):
        multilica.run_calibration("taken.mcap", observe=stop)
    assert names(tmp_path / "recordings" / "runs") == {"taken"}


@pytest.mark.parametrize(
    ("source", "expected"),
    [("drive.mcap", "drive"), ("logs/bag_dir", "bag_dir"), ("a/b.c/x.pcd", "x"), ("s3://bucket/d.mcap?key=k", "d")],
)
def test_the_directory_is_named_after_the_source(
    source: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert default_directory([source, "other.pcd"]) == Path("recordings/runs") / expected
    assert default_directory([source, "other.pcd"], 2) == Path(f"recordings/runs/{expected}-and-1-more")


@pytest.mark.slow
def test_a_run_without_a_directory_leaves_earlier_ones(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    runs = Path("recordings") / "runs"
    first = multilica.run_calibration(recordings / "first.mcap", config=EARLY)
    before = {path.name: path.read_bytes() for path in first.directory.iterdir()}
    later = [multilica.run_calibration(recordings / "first.mcap", config=EARLY).directory for _ in range(2)]
    assert [first.directory, *later] == [runs / "first", runs / "first-2", runs / "first-3"]
    assert {path.name: path.read_bytes() for path in first.directory.iterdir()} == before


@pytest.mark.slow
def test_runs_that_start_together_do_not_replace_one_another(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording of the same name is calibrated while this one is read."""
    monkeypatch.chdir(tmp_path)
    meanwhile: list[Path] = []

    def calibrate_another(event: events.RunEvent) -> None:
        if event == events.StageStarted("ingest", 0) and not meanwhile:
            meanwhile.append(multilica.run_calibration(recordings / "first.mcap", config=EARLY).directory)

    own = multilica.run_calibration(recordings / "first.mcap", config=EARLY, observe=calibrate_another)
    assert [*meanwhile, own.directory] == [Path("recordings/runs/first"), Path("recordings/runs/first-2")]


def test_a_missing_library_is_told_before_anything_is_read(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("multilica.optional_libraries.is_found", lambda module: module != "kiss_matcher")
    monkeypatch.setattr("multilica.run.find_snapshots", lambda *_, **__: pytest.fail("The source was opened."))
    config = with_overrides(FAST, ["coarse.solver=kiss_matcher"])
    with pytest.raises(MissingDependencyError, match="pip install"):
        multilica.run_calibration(recordings / "first.mcap", tmp_path / "run", config)
    assert names(tmp_path) == set()
