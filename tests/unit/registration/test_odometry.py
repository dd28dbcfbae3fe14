# SPDX-License-Identifier: Apache-2.0
"""Odometry of one LiDAR in a made street."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform
from multilica.registration.odometry import Odometer
from multilica.snapshot import Scan

_FRAME_NS = 100_000_000


def _street(rng, count=12_000):
    """Points (N, 3) on a road between facades with bays."""
    x_m = rng.uniform(-20.0, 30.0, count)
    ground = np.column_stack([x_m, rng.uniform(-8.0, 8.0, count), np.full(count, -1.8)])
    side = rng.choice([-1.0, 1.0], count)
    bay = np.floor(x_m / 4.0) % 2.0
    facades = np.column_stack([x_m, side * (8.0 + bay), rng.uniform(-1.8, 5.0, count)])
    across = np.column_stack([np.round(x_m / 4.0) * 4.0, side * rng.uniform(8.0, 9.0, count), facades[:, 2]])
    return np.concatenate([ground, facades, across[: count // 2]])


def _pose(share):
    """Pose (4, 4) after a share of a way of 6 m with a turn of 0.5 rad, from rest to rest."""
    eased = np.clip(share, 0.0, 1.0)
    eased = eased * eased * (3.0 - 2.0 * eased)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", 0.5 * eased).as_matrix()
    pose[:3, 3] = [6.0 * np.sinc(0.25 * eased / np.pi) * eased, 0.75 * eased * eased, 0.0]
    return pose


def _scans(*, timed, frames=24):
    """Frames on the way, each point measured at a time of its own."""
    rng = np.random.default_rng(0)
    for frame in range(frames + 4):
        points_m = _street(rng)
        times = rng.uniform(size=len(points_m))
        order = np.argsort(times)
        points_m, times = points_m[order], times[order]
        measured = []
        for part in np.array_split(np.arange(len(points_m)), 8):
            pose = _pose((frame - 2 + times[part].mean()) / frames)
            measured.append((points_m[part] - pose[:3, 3]) @ pose[:3, :3])
        times_ns = (times * _FRAME_NS).astype(np.uint32) if timed else None
        yield Scan(np.concatenate(measured), 1 + frame * _FRAME_NS, times_ns=times_ns)


def _followed(scans):
    odometer = Odometer()
    for scan in scans:
        if odometer.needs(scan.stamp_ns):
            odometer.add(scan, scan.stamp_ns)
    return odometer


@pytest.mark.slow
@pytest.mark.parametrize(("timed", "limit_m", "limit_deg"), [(True, 0.06, 0.1), (False, 0.2, 1.0)])
def test_odometry_follows_a_turn(timed, limit_m, limit_deg):
    odometer = _followed(_scans(timed=timed))
    motion = odometer.motion("front")
    truth = RigidTransform("front", "front", _pose(1.0))
    distance_m, angle_rad = motion.T_before_now.distance_to(truth)
    assert distance_m < limit_m
    assert np.rad2deg(angle_rad) < limit_deg
    error = motion.T_before_now.offset_from(truth)
    assert error @ np.linalg.solve(motion.covariance, error) < 22.0
    assert motion.way_m == pytest.approx(6.0, abs=0.3)
    assert odometer.covers(1, 20 * _FRAME_NS)
    assert not odometer.covers(0, 20 * _FRAME_NS)


def test_frames_at_rest_are_mostly_left_out():
    still = list(_scans(timed=False, frames=2))[:1]
    odometer = Odometer()
    odometer.add(still[0], 0)
    odometer.add(Scan(still[0].points_m, still[0].stamp_ns + _FRAME_NS), _FRAME_NS)
    assert [odometer.needs(_FRAME_NS + ms * 1_000_000) for ms in (50, 100, 200)] == [False, False, True]


@pytest.mark.parametrize("index", [0, 3])
def test_a_frame_without_points_is_left_out(index):
    scans = [*_scans(timed=False)][:8]
    empty = Scan(np.empty((0, 3), np.float32), scans[index].stamp_ns)
    others = [*scans[:index], *scans[index + 1 :]]
    with_gap, without = (
        _followed(each).motion("front") for each in ([*scans[:index], empty, *scans[index + 1 :]], others)
    )
    assert with_gap.frames == without.frames
    np.testing.assert_array_equal(with_gap.T_before_now.matrix, without.T_before_now.matrix)


def test_a_lost_track_gives_no_motion():
    scans = [*_scans(timed=False)]
    assert _followed([*scans[:3], *scans[18:]]).motion("front") is None
    turned = Scan(scans[0].points_m[:, [1, 0, 2]], scans[2].stamp_ns)
    assert _followed([scans[0], turned, scans[4]]).motion("front") is None
    assert _followed(scans[:1]).motion("front") is None
