# SPDX-License-Identifier: Apache-2.0
"""Calibrations of a small simulated rig, with their events."""

from functools import cache

import numpy as np

from multilica.config import CalibrationConfig, with_overrides
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.snapshot import LidarScans, Scan, Snapshot

GOOD_M, GOOD_RAD = 0.02, np.deg2rad(0.1)


@cache
def sides(*disturbances):
    return simulate_snapshot("sides", "garage", 101, frames=1, disturbances=disturbances)


def only(snapshot, *names, every=1):
    """Fewer LiDARs with fewer returns, for tests that look at the order and not at the pose."""
    scans = {name: snapshot[name].scans[0].points_m[::every] for name in names}
    return Snapshot(tuple(LidarScans(name, (Scan(points),)) for name, points in scans.items()))


def watched(snapshot, *settings, base=None, earlier=None):
    seen = []
    result = calibrate(snapshot, with_overrides(base or CalibrationConfig(), settings), seen.append, earlier=earlier)
    return result, seen


def of(kind, seen):
    return [event for event in seen if isinstance(event, kind)]


def assert_true(result, truth):
    for placement in result.placements:
        metres, radians = placement.T_target_source.distance_to(truth.between(result.target, placement.lidar))
        assert metres < GOOD_M, (placement.lidar, metres)
        assert radians < GOOD_RAD, (placement.lidar, radians)
