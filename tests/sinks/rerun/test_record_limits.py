# SPDX-License-Identifier: Apache-2.0
"""Limits on the size of recordings."""

from __future__ import annotations

import numpy as np
import pytest

from multilica import events
from multilica.config import CalibrationConfig, RecordConfig
from multilica.results import CalibrationResult, LidarPlacement, Refusal
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.scene import NO_LIMITS, RecordPlan, RerunScene, lidar_path, limits_for
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.sinks.conftest import record
from tests.sinks.made_events import LIDARS, TARGET, made_events
from tests.sinks.recording_reader import Recording


def rig_of(lidars: int, points: int) -> Snapshot:
    scan = Scan(np.zeros((points, 3), dtype=np.float32), 1)
    return Snapshot(tuple(LidarScans(f"lidar{index}", (scan,)) for index in range(lidars)), "rig", "")


def test_a_small_rig_is_not_thinned():
    assert limits_for(RecordConfig(), rig_of(4, 100_000)).share == 1.0


def test_what_exceeds_the_budget_is_thinned_by_one_share():
    usual = limits_for(RecordConfig(), rig_of(2, 1000)).limits
    limits, share, _ = limits_for(RecordConfig(max_megabytes=25.0), rig_of(8, 300_000))
    assert 0.0 < share < 0.2
    assert limits == tuple(int(share * limit) for limit in usual)
    assert limits_for(RecordConfig(max_megabytes=30.0), rig_of(8, 300_000)).share > share


def test_many_lidars_keep_points_for_the_pairs_of_a_search():
    plan = limits_for(RecordConfig(), rig_of(20, 60_000))
    assert 0.2 < plan.share < 1.0
    assert 57 <= plan.pairs < 190


def test_pairs_beyond_the_plan_get_a_tenth(tmp_path):
    scene = RerunScene(None, RunState(), tmp_path)
    scene.plan = RecordPlan(scene.limits._replace(pair_points=30_000), 0.5, 2)
    pairs = [("front", "rear"), ("rear", "front"), ("front", "top"), ("rear", "top"), ("front", "rear")]
    assert [scene.limits_of(pair).pair_points for pair in pairs] == [30_000, 30_000, 30_000, 3000, 30_000]


@pytest.mark.parametrize("outcome", ["complete", "partial"])
def test_no_part_of_a_pair_beyond_the_plan_is_larger(tmp_path, monkeypatch, outcome):
    """Points and labels of a pair have the same length at each step."""
    limits = NO_LIMITS._replace(pair_points=900, scored_points=300, match_rows=100, matches=50)
    monkeypatch.setattr("multilica.sinks.rerun.recording.limits_for", lambda *_: RecordPlan(limits, 0.5, 0))
    recording, pair = Recording(record(tmp_path / "run.rrd", outcome)), "/pairs/rear/top"
    assert len(recording.last(f"{pair}/source", "Points3D:positions")) == 90
    for side in ("source", "target"):
        sizes = [len(cell) for _, cell in recording.cells(f"{pair}/scored/{side}", "Points3D:class_ids")]
        assert {*sizes, len(recording.cells(f"{pair}/scored/{side}", "Points3D:positions")[0][1])} == {30}
    for column in ("target_index", "agrees_with", "residual_m"):
        assert len(recording.last(f"{pair}/matches/data", column)) == 10
    assert len(recording.last(f"{pair}/matches/rejected", "LineStrips3D:strips")) == 5
    assert len(recording.last(f"{pair}/fine/matches", "distance_m")) == 10


def test_full_has_no_budget():
    assert limits_for(RecordConfig(detail="full", max_megabytes=0.001), rig_of(8, 300_000))[:2] == (NO_LIMITS, 1.0)


@pytest.mark.slow
def test_a_recording_stays_below_its_budget(tmp_path):
    config = CalibrationConfig(target=TARGET, record={"max_megabytes": 5.0})
    _, *rest = made_events()
    noise = np.random.default_rng(0).normal(scale=10.0, size=(200_000, 3)).astype(np.float32)
    snapshot = Snapshot(tuple(LidarScans(name, (Scan(noise, 1),)) for name in LIDARS), "rig", "")
    with RerunRecording(tmp_path / "run.rrd") as observe:
        for event in (events.CalibrationStarted(snapshot, config), *rest):
            observe(event)
    assert 3e6 < (tmp_path / "run.rrd").stat().st_size < 5e6
    line = next(text for step, level, text in Recording(tmp_path / "run.rrd").log if step == 0 and level == "WARN")
    assert line.startswith("recording ")
    assert line.endswith("of the usual points and matches to stay below 5 MB (record.max_megabytes)")


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("detail", ["full", "normal", "slim"])
def test_every_detail_keeps_every_decision(tmp_path, rerun_rrd, detail):
    path = record(tmp_path / "run.rrd", "partial", record={"detail": detail})
    assert rerun_rrd("verify", path).returncode == 0
    recording = Recording(path)
    assert {"/pairs/rear/top/scores", "/merge/steps", "/verdicts/picture", "/summary"} <= recording.entity_paths
    raw = {f"/lidars/{name}/raw" for name in LIDARS} & recording.entity_paths
    assert bool(raw) == (detail != "slim")


def test_slim_says_that_raw_clouds_are_missing(tmp_path):
    recording = Recording(record(tmp_path / "run.rrd", record={"detail": "slim"}))
    assert (0, "INFO", "top: 0 of 1,200 raw points are recorded") in recording.log
    assert "/lidars/top/features" not in recording.entity_paths
    assert recording.last("/lidars/top/preprocessed", "Points3D:positions")


def test_a_refused_slim_run_shows_some_raw_points(tmp_path):
    """It has no other clouds."""
    started, *_ = made_events()
    unplaced = tuple(LidarPlacement(name, "refused") for name in LIDARS)
    refused = CalibrationResult(TARGET, "", unplaced, refusal=Refusal("moving_vehicle", "the vehicle moves"))
    config = CalibrationConfig(target=TARGET, record={"detail": "slim"})
    with RerunRecording(tmp_path / "run.rrd") as observe:
        observe(events.CalibrationStarted(started.snapshot, config))
        observe(events.CalibrationFinished(refused))
    recording = Recording(tmp_path / "run.rrd")
    assert all(recording.last(lidar_path(name, "raw"), "Points3D:positions") for name in LIDARS)
