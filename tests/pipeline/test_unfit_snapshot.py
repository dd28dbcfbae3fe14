# SPDX-License-Identifier: Apache-2.0
"""Snapshots that are refused before any work."""

import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.errors import UnfitSnapshotError, UnknownNameError
from multilica.orchestration.clouds import without_blind_target
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.snapshot import LidarScans, Scan, Snapshot


def _snapshot(*names, disturbances=()):
    snapshot = simulate_snapshot("sides", "garage", 101, frames=1, disturbances=disturbances, sensors="ideal").snapshot
    return Snapshot(tuple(LidarScans(name, (Scan(snapshot[name].scans[0].points_m),)) for name in names), "made.mcap")


def test_an_unknown_target_is_named_before_any_work():
    seen = []
    with pytest.raises(UnknownNameError, match=r"no LiDAR 'tip' in .*available: left, right, top.*mean 'top'"):
        calibrate(_snapshot("left", "right", "top"), CalibrationConfig(target="tip"), seen.append)
    assert seen == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "settings", "message"),
    [
        (("top",), (), r"has 1 LiDAR\(s\) with returns \(top\)\. Calibration needs at least two"),
        ((), (), r"has 0 LiDAR\(s\) with returns \(none\)"),
        (("left", "top"), ("preprocess.min_range_m=99",), r"0 LiDAR\(s\) with returns between 99 m and 100 m .*two"),
    ],
)
def test_fewer_than_two_lidars_with_returns_are_unfit(names, settings, message):
    with pytest.raises(UnfitSnapshotError, match=message):
        calibrate(_snapshot(*names), with_overrides(CalibrationConfig(), settings))


def test_a_target_without_returns_is_unfit():
    with pytest.raises(UnfitSnapshotError, match=r"no returns of the target LiDAR 'left' .*another target: right, top"):
        calibrate(_snapshot("left", "right", "top", disturbances=("dead:left",)), CalibrationConfig(target="left"))


@pytest.mark.parametrize(
    ("names", "disturbances", "target"),
    [
        (("left", "right", "top"), (), "left"),
        (("left", "right", "top"), ("dead:left",), ""),
        (("right", "top"), (), ""),
    ],
    ids=["seen", "silent", "absent"],
)
def test_a_stop_without_returns_of_the_target_has_another_one(names, disturbances, target):
    snapshot = _snapshot(*names, disturbances=disturbances)
    assert without_blind_target(snapshot, CalibrationConfig(target="left")).target == target
