# SPDX-License-Identifier: Apache-2.0
"""LiDARs of snapshots that were refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from multilica import events, run
from multilica.config import CalibrationConfig
from multilica.drive_calibration import calibrate_alone
from multilica.errors import UnfitSnapshotError
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
    found = calibrate_alone(
        "stop_1", snapshot, CalibrationConfig(), events.ignore, Workers(), 1e9, None, EarlierStops()
    )
    assert (found.result, found.lidars, found.source_sha256) == (None, ("top",), "c0ffee")


def test_a_refused_recording_keeps_its_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    snapshot = Snapshot((LidarScans("top", (Scan(np.ones((9, 3), np.float32)),)),), source_sha256="c0ffee")

    def refuse(*_: object) -> None:
        raise UnfitSnapshotError("The vehicle moves.")

    monkeypatch.setattr(run, "_read", lambda *_: SimpleNamespace(snapshot=snapshot))
    monkeypatch.setattr(run, "_run_one", refuse)
    given = SimpleNamespace(name="stop_1", source="a.mcap", snapshot=snapshot, paths=())
    request = run._Request(CalibrationConfig(target="top"), None, None, "ros2", events.ignore, Workers(), 1e9)
    found = run._run_alone(given, Path("stop_1"), request, None, EarlierStops())
    assert (found.refusal, found.source_sha256) == ("The vehicle moves.", "c0ffee")
