# SPDX-License-Identifier: Apache-2.0
"""Two runs on the same input leave the same recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.sinks.rerun.recording import RerunRecording
from multilica.snapshot import LidarScans, Scan, Snapshot


@pytest.fixture(scope="module")
def snapshot() -> Snapshot:
    simulated = simulate_snapshot("sides", "garage", 101, frames=1).snapshot
    scans = {name: simulated[name].scans[0].points_m[::6] for name in ("left", "top")}
    return Snapshot(tuple(LidarScans(name, (Scan(points),)) for name, points in scans.items()))


def run(path: Path, snapshot: Snapshot) -> Path:
    quick = ("fine.max_finalists=1", "coarse.max_hypotheses=3", "fine.max_points=3000", "until=fine")
    config = with_overrides(CalibrationConfig(), quick)
    with RerunRecording(path) as observe:
        calibrate(snapshot, config, observe)
    return path


@pytest.mark.slow
@pytest.mark.in_turn
def test_two_runs_are_equal_apart_from_times(snapshot, tmp_path, rerun_rrd):
    first, second = (run(tmp_path / name, snapshot) for name in ("first.rrd", "second.rrd"))
    verdict = rerun_rrd("compare", "--unordered", first, second)
    assert verdict.returncode == 0, verdict.stderr
