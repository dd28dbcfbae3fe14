# SPDX-License-Identifier: Apache-2.0
"""The recording as data, read with Rerun's own reader."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica import events
from multilica.errors import UnreadableSourceError
from multilica.sinks.rerun.reading import TABLES, read_recorded_table
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.tables import _pair_row
from multilica.sinks.run_state import RunState
from tests.selection import some_of
from tests.sinks.conftest import record
from tests.sinks.made_events import LIDARS, TARGET, TRUTH, UNPLACED, made_events
from tests.sinks.made_surfaces import COUNT
from tests.sinks.recording_reader import Recording

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "recording-layout.md").read_text(encoding="utf-8")
PAIR = "/pairs/rear/top"


def _matched(outcome):
    return {
        (event.correspondences.target, event.correspondences.source): event.correspondences
        for event in made_events(outcome)
        if isinstance(event, events.CorrespondencesMatched)
    }


def _registered(outcome):
    """Target and source of each registration, else as matched, in the order of `_matched`."""
    found = [event.registration for event in made_events(outcome) if isinstance(event, events.PairRegistered)]
    ends = {frozenset((each.target, each.source)): (each.target, each.source) for each in found}
    return [ends.get(frozenset(pair), pair) for pair in sorted(_matched(outcome))]


@pytest.mark.parametrize("outcome", ["complete", "partial", "failed"])
def test_the_documented_lines_read_the_pairs(recordings, outcome, monkeypatch):
    monkeypatch.chdir(recordings[outcome].parent)
    (recordings[outcome].parent / "run").mkdir(exist_ok=True)
    (recordings[outcome].parent / "run" / "recording.rrd").unlink(missing_ok=True)
    (recordings[outcome].parent / "run" / "recording.rrd").symlink_to(recordings[outcome])
    (code,) = re.findall(r"```python\n(.+?)```", PAGE.split("## As data\n")[1], flags=re.DOTALL)
    assert len([line for line in code.splitlines() if line and not line.startswith(("import", "from", "print"))]) == 3
    names: dict = {}
    exec(code, names)  # noqa: S102 - the documentation's own lines
    pairs = names["pairs"]
    assert list(zip(pairs["target"], pairs["source"], strict=True)) == _registered(outcome)
    refused = [UNPLACED in pair or outcome == "failed" for pair in zip(pairs["target"], pairs["source"], strict=True)]
    accepted = [verdict == "accept" for verdict in pairs["verdict"]]
    assert accepted == [not (each and outcome != "complete") for each in refused]


def test_figures_of_a_pair_are_scalars(recordings):
    recording = Recording(recordings["partial"])
    for path, value in {
        "correspond/matches": 80.0,
        "coarse/hypotheses": 2.0,
        "coarse/agreeing_matches": 20.0,
        "verify/coverage": 90 / 96,
        "fine/fitness": 0.1,
        "fine/rmse_m": 0.06,
        "merge/fitness": 0.1,
        "merge/evidence": -1.2,
    }.items():
        assert recording.last(f"{PAIR}/{path}", "Scalars:scalars") == pytest.approx([value]), path
    refined = recording.last("/pairs/front\\ left\\/1/top/refine/residual_m", "Scalars:scalars")
    assert refined == pytest.approx([0.001])


def test_the_style_of_a_candidate_is_logged_once(recordings):
    """The pair is matched as `rear <- top`; both merge steps have it as a candidate."""
    recording, path = Recording(recordings["partial"]), f"{PAIR}/merge/evidence"
    assert len(recording.cells(path, "Scalars:scalars")) == 2
    for series in ("SeriesLines", "SeriesPoints"):
        assert [cell for _, cell in recording.cells(path, f"{series}:names")] == [["top <- rear"]]


def test_matches_are_recorded_in_their_own_frames(recordings):
    recording, truth = Recording(recordings["complete"]), _matched("complete")["rear", "top"]
    path = f"{PAIR}/matches/data"
    assert recording.last(path, "target_index") == truth.target_index.tolist()
    assert recording.last(path, "source_index") == truth.source_index.tolist()
    np.testing.assert_allclose(recording.last(path, "target_point_m"), truth.target_points_m, atol=1e-4)
    np.testing.assert_allclose(recording.last(path, "source_point_m"), truth.source_points_m, atol=1e-4)
    np.testing.assert_allclose(recording.last(path, "feature_distance"), truth.feature_distances, atol=1e-6)
    agree = recording.last(path, "agrees_with")
    assert [0 in each for each in agree] == [row % 4 == 0 for row in range(80)]
    moved_m = (TRUTH["rear"].inverse() @ TRUTH["top"]).apply(truth.source_points_m)
    residual_m = np.linalg.norm(moved_m - truth.target_points_m, axis=1)
    np.testing.assert_allclose(recording.last(path, "residual_m"), residual_m, atol=1e-3)


def test_points_of_a_match_are_rows_of_the_descriptors(recordings):
    recording = Recording(recordings["complete"])
    found = recording.last(f"{PAIR}/matches/data", "source_point_m")
    rows = recording.last(f"{PAIR}/matches/data", "source_index")
    points = np.asarray(recording.last("/lidars/top/features", "Points3D:positions"))
    np.testing.assert_allclose(found, points[rows], atol=1e-4)


@pytest.mark.slow
def test_full_detail_keeps_every_match_and_slim_few(tmp_path):
    counts = {}
    for detail in ("full", "slim"):
        path = tmp_path / f"{detail}.rrd"
        with RerunRecording(path) as observe:
            for event in made_events("complete", record={"detail": detail}):
                observe(_multiplied(event) if isinstance(event, events.CorrespondencesMatched) else event)
        counts[detail] = len(Recording(path).last(f"{PAIR}/matches/data", "target_index"))
    assert counts == {"full": 800, "slim": 200}


def _multiplied(event):
    rows = np.tile(np.arange(len(event.correspondences)), 10)
    return events.CorrespondencesMatched(event.correspondences.subset(rows))


@pytest.mark.slow
@pytest.mark.in_turn
def test_tables_are_read_whole(recordings):
    pairs = read_recorded_table(recordings["partial"], "pairs").to_pylist()
    of_pair = next(row for row in pairs if (row["target"], row["source"]) == ("rear", "top"))
    assert of_pair["matches"] == 80
    assert of_pair["verdict"] == "reject"
    assert of_pair["reasons"] == "too_little_evidence,ambiguous,not_observable"
    assert of_pair["pose_from"] == "clique 0"
    true_pose = TRUTH["rear"].inverse() @ TRUTH["top"]
    assert [of_pair[name] for name in ("x_m", "y_m", "z_m")] == pytest.approx(true_pose.xyz_m.tolist())
    merge = read_recorded_table(recordings["partial"], "merge").to_pylist()
    assert [(row["merge_step"], row["rank"], row["source"], row["chosen"]) for row in merge] == [
        (1, 1, LIDARS[0], True),
        (1, 2, UNPLACED, False),
        (2, 1, UNPLACED, False),
    ]
    assert {row["target"] for row in merge} == {TARGET}
    matches = read_recorded_table(recordings["partial"], "matches").to_pylist()
    assert len(matches) == 3 * 80
    assert {row["agrees_with"] for row in matches} <= {"0", "1", "0 1", ""}
    surfaces = read_recorded_table(recordings["partial"], "surfaces").to_pylist()
    assert len(surfaces) == 3 * COUNT
    assert {(round(row["distance_m"], 6), round(row["plane_distance_m"], 6)) for row in surfaces} == {(0.02, 0.01)}


@pytest.mark.slow
def test_timings_are_those_of_the_result(recordings):
    rows = read_recorded_table(recordings["complete"], "timings").to_pylist()
    assert [row["stage"] for row in rows] == ["fine"]
    assert rows[0]["seconds"] == pytest.approx(0.01, abs=1e-8)


def test_times_of_stages_change_no_entity_but_by_time(tmp_path, rerun_rrd):
    """Stages that took longer than the recording need frames before its start."""
    paths = tmp_path / "quick.rrd", tmp_path / "slow.rrd"
    for path, seconds in zip(paths, (1e-9, 500.0), strict=True):
        with RerunRecording(path) as observe:
            for event in made_events(until="correspond"):
                finishes = isinstance(event, events.CalibrationFinished)
                timed = replace(event.result, timing_s={"ingest": seconds}) if finishes else None
                observe(event if timed is None else events.CalibrationFinished(timed))
    verdict = rerun_rrd("compare", "--unordered", *paths)
    assert verdict.returncode == 0, verdict.stderr


@pytest.fixture(scope="module")
def cut_off(tmp_path_factory):
    path = tmp_path_factory.mktemp("cut off") / "recording.rrd"
    told = list(made_events("complete"))
    merged = next(index for index, event in enumerate(told) if isinstance(event, events.MergeStepTaken))
    with RerunRecording(path) as observe:
        for event in told[:merged]:
            observe(event)
    return path.with_name("recording.partial.rrd")


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("name", some_of(TABLES, 1))
def test_a_recording_that_was_cut_off_has_the_tables_so_far(cut_off, name):
    rows = read_recorded_table(cut_off, name).num_rows
    assert rows == {"pairs": 3, "matches": 240, "surfaces": 0, "merge": 0, "timings": 0}[name]


@pytest.fixture(scope="module")
def of_an_earlier_version(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        for log in ("log_data_tables", "tables.log_timings"):
            patch.setattr(f"multilica.sinks.rerun.recording.{log}", lambda *_: None)
        return record(tmp_path_factory.mktemp("old") / "old.rrd", "partial")


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("name", some_of(TABLES, 1))
def test_a_recording_of_an_earlier_version_is_refused(of_an_earlier_version, name):
    with pytest.raises(UnreadableSourceError, match=r"earlier version of multilica wrote it; calibrate again"):
        read_recorded_table(of_an_earlier_version, name)


def test_the_residual_map_goes_from_dark_to_bright(recordings):
    recording = Recording(recordings["complete"])
    packed = recording.last("/lidars/top/residual", "Points3D:colors")
    brightness = [sum(colour >> shift & 255 for shift in (8, 16, 24)) for colour in packed]
    assert brightness[0] < brightness[COUNT // 4] < brightness[-1]
    assert brightness[COUNT // 2] == brightness[-1]


def test_figures_of_stages_that_did_not_run_are_unknown():
    """A joint result has registrations of the stop that is shown, and no matches."""
    state = RunState()
    for event in made_events("partial"):
        if not isinstance(event, events.CorrespondencesMatched | events.HypothesesFound):
            state(event)
    row = _pair_row(state, state.pairs[0], None)
    assert (row["matches"], row["hypotheses"]) == (None, None)
    assert row["verdict"] != "no pose"
