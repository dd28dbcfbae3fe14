# SPDX-License-Identifier: Apache-2.0
"""The recording of a run."""

from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pytest

from multilica import events
from multilica.config import STAGES
from multilica.results import PreprocessedCloud
from multilica.sinks.files.atomic import partial_path
from multilica.sinks.rerun.recording import RerunRecording
from multilica.snapshot import LidarScans
from tests.sinks.conftest import record
from tests.sinks.made_events import LIDARS, TARGET, TRUTH, UNPLACED, made_events
from tests.sinks.recording_reader import Recording, blueprint_names


@pytest.mark.slow
def test_rerun_accepts_the_file(recordings, rerun_rrd):
    for path in recordings.values():
        verdict = rerun_rrd("verify", path)
        assert verdict.returncode == 0, verdict.stderr


@pytest.mark.in_turn
@pytest.mark.slow
def test_two_runs_record_the_same(recordings, rerun_rrd, tmp_path):
    again = record(tmp_path / "again.rrd")
    verdict = rerun_rrd("compare", "--unordered", recordings["complete"], again)
    assert verdict.returncode == 0, verdict.stderr
    assert rerun_rrd("compare", "--unordered", recordings["partial"], again).returncode != 0


@pytest.mark.parametrize("status", ["complete", "partial", "failed"])
def test_properties_say_what_it_is(recordings, status):
    properties = Recording(recordings[status]).properties()
    assert properties["status"] == status
    assert properties["version"]
    assert properties["input_source"] == "drive.mcap"
    assert properties["input_sha256"].startswith("c0ffee")
    assert tomllib.loads(properties["config"])["target"] == TARGET


def test_each_event_advances_the_step(recordings):
    recording = Recording(recordings["complete"])
    steps = [step for step, _, _ in recording.log]
    happened = list(made_events())
    assert steps[0] == 0
    assert max(steps) >= len(happened) - 1
    stages = [text for _, _, text in recording.log if text.startswith("stage") and text.endswith("finished")]
    assert stages == [f"stage {e.stage} finished" for e in happened if isinstance(e, events.StageFinished)]


def test_a_cloud_costs_12_bytes_a_point_and_one_colour(recordings):
    recording = Recording(recordings["complete"])
    assert [len(cell) for _, cell in recording.cells("/lidars/top/raw", "Points3D:positions")] == [1200]
    assert [len(cell) for _, cell in recording.cells("/lidars/top/raw", "Points3D:colors")] == [1]
    chunk = next(chunk for chunk in recording.chunks if chunk.entity_path == "/lidars/top/raw")
    assert chunk.to_record_batch().column("Points3D:positions").nbytes < 12.5 * 1200


def test_the_source_cloud_is_logged_once_and_moved_by_its_frame(recordings):
    recording = Recording(recordings["complete"])
    assert len(recording.cells("/pairs/rear/top/source", "Points3D:positions")) == 1
    frames = [cell[0] for _, cell in recording.cells("/pairs/rear/top/source", "CoordinateFrame:frame")]
    assert {"pair/rear/top/0", "pair/rear/top/1"} <= set(frames)
    assert frames[-1] == "pair/rear/top/0"


@pytest.mark.slow
def test_the_result_hangs_every_placed_lidar_below_the_target(recordings):
    recording = Recording(recordings["complete"])
    for name in set(LIDARS) - {TARGET}:
        path = f"/lidars/{name}/sensor".replace(" ", "\\ ").replace("left/1", "left\\/1")
        assert recording.last(path, "Transform3D:parent_frame") == [f"lidar/{TARGET}"]
        translation = recording.last(path, "Transform3D:translation")[0]
        np.testing.assert_allclose(translation, TRUTH[name].xyz_m, atol=1e-6)
        quaternion = recording.last(path, "Transform3D:quaternion")[0]
        np.testing.assert_allclose(quaternion, TRUTH[name].quaternion_xyzw, atol=1e-6)


def test_what_is_not_placed_stays_in_its_slot(recordings):
    recording = Recording(recordings["partial"])
    assert recording.last("/lidars/rear/sensor", "Transform3D:parent_frame") == ["slot/rear"]
    assert ("ERROR", f"{UNPLACED} is not placed: its best registration has fitness 0.100, below 0.2") in [
        line[1:] for line in recording.log
    ]


def test_matches_are_kept_or_rejected(recordings):
    recording = Recording(recordings["complete"])
    kept = recording.last("/pairs/rear/top/matches/kept", "LineStrips3D:strips")
    rejected = recording.last("/pairs/rear/top/matches/rejected", "LineStrips3D:strips")
    assert (len(kept), len(rejected)) == (20, 60)
    lengths = [np.linalg.norm(np.subtract(*strip)) for strip in kept]
    np.testing.assert_allclose(lengths, lengths[0], atol=0.2)


def test_a_reverse_registration_moves_the_pair_as_matched(recordings):
    recording = Recording(recordings["complete"])
    path = "/pairs/front\\ left\\/1/rear/poses/0"
    truth = TRUTH["front left/1"].inverse() @ TRUTH["rear"]
    np.testing.assert_allclose(recording.last(path, "Transform3D:translation")[0], truth.xyz_m, atol=1e-5)


def test_curves_run_over_iterations(recordings):
    recording = Recording(recordings["complete"])
    curve = "/gicp/fitness/top/rear/merged-1"
    by_iteration = recording.cells(curve, "Scalars:scalars", "iteration")
    assert by_iteration == [(3, [0.0]), (6, [0.1]), (9, [0.2]), (12, [pytest.approx(0.3)])]
    steps = [step for step, _ in recording.cells(curve, "Scalars:scalars")]
    assert steps == list(range(steps[0], steps[0] + 4))


def test_the_graph_carries_what_ranks_the_pairs(recordings):
    labels = Recording(recordings["partial"]).last("/merge/graph", "GraphNodes:labels")
    assert labels == [*LIDARS, "evidence 9.5 merged", "evidence -1.2 reject"]


def test_the_matrices_and_the_table_of_pairs_agree(recordings):
    recording = Recording(recordings["partial"])
    table = recording.last("/pair_figures", "TextDocument:text")[0]
    doubts = "too little evidence, ambiguous, not observable"
    assert f"| rear <- top | 80 | 80 | 200 | 0.100 | 0.938 | 1.1% | reject | {doubts} |" in table
    for path, expected in (("/fitness", [0.1, np.nan, 0.1]), ("/coverage", [90 / 96, np.nan, 90 / 96])):
        tensor = recording.last(path, "Tensor:data")[0]
        shares = np.asarray(tensor["buffer"], dtype=np.float32).reshape(tensor["shape"])
        np.testing.assert_allclose(shares[1], expected, rtol=1e-6)
    assert recording.last("/verdicts/labels", "Points2D:labels")[:3] == ["accept", "reject", "reject"]


def test_the_blueprint_opens_on_what_matters(recordings):
    complete, partial = (blueprint_names(recordings[status])[-1] for status in ("complete", "partial"))
    stages = {"Input", "Preprocess", "Features", "Correspond", "Coarse + verify", "Fine", "Merge", "Log"}
    assert stages | {"Result", "Merged cloud", "Summary"} <= complete
    assert not any(name.startswith("Not placed") for name in complete)
    assert stages | {"Not placed: rear", "Scores", "Result"} <= partial
    assert "rear <- top, competing pose: green agrees there as well" in partial
    assert "rear <- top: green agrees, red lies in proven-empty space, grey is occluded" in partial


def test_a_run_stopped_after_a_stage_has_tabs_up_to_it(tmp_path):
    path = record(tmp_path / "until.rrd", until="coarse")
    names = blueprint_names(path)[-1]
    assert {"Input", "Correspond", "Coarse", "Log"} <= names
    assert not any("green agrees" in name for name in names)
    assert not names & {"Fine", "Merge", "Result", "Not placed"}


@pytest.mark.parametrize("stage", [stage for stage in STAGES if stage not in ("coarse", "refine", "ground")])
@pytest.mark.in_turn
def test_a_run_can_stop_after_any_stage(tmp_path, stage):
    recording = Recording(record(tmp_path / "until.rrd", until=stage))
    assert f"stage {stage} finished" in [text for _, _, text in recording.log]


def test_a_lidar_without_a_point_is_recorded(tmp_path):
    first, *_ = made_events()
    empty = dataclasses.replace(first.snapshot, lidars=(LidarScans("dead", ()), *first.snapshot.lidars))
    nothing = np.empty((0, 3))
    path = tmp_path / "dead.rrd"
    with RerunRecording(path) as observe:
        observe(events.CalibrationStarted(empty, first.config))
        observe(events.CloudPreprocessed(PreprocessedCloud("dead", nothing, nothing)))
        observe(events.StageFinished("preprocess", 0.0))
    recording = Recording(partial_path(path))
    assert ("ERROR", "dead: 0 points after cleaning and thinning; dropped: none") in [
        line[1:] for line in recording.log
    ]


@pytest.mark.slow
def test_an_error_leaves_the_partial_recording_with_its_cause(tmp_path, rerun_rrd):
    path = tmp_path / "run.rrd"

    def stop_in_the_fine_stage() -> None:
        with RerunRecording(path) as observe:
            for event in made_events():
                observe(event)
                if isinstance(event, events.PairRegistered):
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_in_the_fine_stage()
    assert not path.exists()
    assert rerun_rrd("verify", partial_path(path)).returncode == 0
    recording = Recording(partial_path(path))
    assert recording.log[-1][1:] == ("ERROR", "the run ended early: KeyboardInterrupt")
    assert recording.properties()["status"] == "interrupted"
    assert "cut off after stage features, in stage fine" in recording.last("/summary", "TextDocument:text")[0]


def test_a_run_without_events_leaves_no_file(tmp_path):
    with RerunRecording(tmp_path / "run.rrd"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_every_event_type_is_in_the_made_runs():
    """Whoever adds an event has to decide how it is shown."""
    happened = {type(event) for outcome in ("complete", "partial") for event in made_events(outcome, at_stops=True)}
    kinds = {kind for kind in vars(events).values() if isinstance(kind, type) and issubclass(kind, events.Event)}
    assert happened == kinds - {events.Event}
    assert all(dataclasses.is_dataclass(kind) for kind in happened)


@pytest.mark.slow
@pytest.mark.parametrize("outcome", ["complete", "partial", "failed", "drive"])
def test_a_frame_is_known_before_something_is_in_it(recordings, outcome):
    """On the wall clock each entity has a time of its own, so that the order shows."""
    recording = Recording(recordings[outcome])
    since = {child: at for at, child in times_of(recording, "Transform3D:child_frame")}
    assert {f"lidar/{name}" for name in LIDARS} < set(since)
    start = min(at for at in since.values() if at)
    for needs in ("CoordinateFrame:frame", "Transform3D:parent_frame"):
        late = {frame for at, frame in times_of(recording, needs) if since.get(frame, 0) > max(at, start)}
        assert not late, needs
    assert {"display"} == {frame for _, frame in times_of(recording, "Transform3D:parent_frame")} - set(since)


def times_of(recording, column):
    """(wall clock, 0 if static, and frame) of each frame in a column, the latest first."""
    found = []
    for chunk in recording.chunks:
        batch = chunk.to_record_batch()
        if column in batch.schema.names and ("log_time" in batch.schema.names or chunk.is_static):
            times = [0] * batch.num_rows if chunk.is_static else batch.column("log_time").cast("int64").to_pylist()
            cells = batch.column(column).to_pylist()
            found += [(at, cell[0]) for at, cell in zip(times, cells, strict=True) if cell]
    return sorted(found, reverse=True)
