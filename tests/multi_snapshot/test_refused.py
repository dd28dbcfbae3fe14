# SPDX-License-Identifier: Apache-2.0
"""LiDARs of snapshots that were refused."""

from __future__ import annotations

import numpy as np

from multilica import events
from multilica.config import CalibrationConfig
from multilica.drive_calibration import calibrate_alone
from multilica.multi_snapshot.snapshot_run import SnapshotRun, only_refused
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.results import CalibrationResult
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.workers import Workers


def test_a_lidar_that_only_refused_snapshots_have_is_listed() -> None:
    runs = [
        SnapshotRun("a", CalibrationResult("T", "", ())),
        SnapshotRun("b", None, refusal="It moves.", lidars=("T", "Z", "Y")),
        SnapshotRun("c", None, refusal="It moves, too.", lidars=("Z",)),
        SnapshotRun("d", None, refusal="It cannot be read."),
    ]
    found = only_refused(runs, {"T"})
    assert [(each.lidar, each.status) for each in found] == [("Y", "not_placed"), ("Z", "not_placed")]
    assert found[1].reason == "b: left out: It moves. c: left out: It moves, too"
    assert only_refused(runs, {"T", "Y", "Z"}) == ()


def test_a_refused_stop_of_a_log_tells_its_lidars() -> None:
    snapshot = Snapshot((LidarScans("top", (Scan(np.ones((9, 3), np.float32)),)),), source_sha256="c0ffee")
    run = calibrate_alone("stop_1", snapshot, CalibrationConfig(), events.ignore, Workers(), 1e9, None, EarlierStops())
    assert (run.result, run.lidars, run.source_sha256) == (None, ("top",), "c0ffee")
