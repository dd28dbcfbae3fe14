# SPDX-License-Identifier: Apache-2.0
"""The peer on drives: hand-eye calibration from odometry by KISS-ICP."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.bench.support.hand_eye import follow, hand_eye

_MOUNT = np.eye(4)
_MOUNT[:3, :3] = Rotation.from_euler("xyz", [2.0, -3.0, 170.0], degrees=True).as_matrix()
_MOUNT[:3, 3] = [-2.5, 0.3, 0.2]


def _way(yaw_deg, pitch_deg, way_m):
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_euler("zy", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    motion[:3, 3] = [way_m, 0.2 * way_m, 0.0]
    return motion


def test_hand_eye_finds_the_pose_from_exact_motions():
    ways = [_way(60.0, 4.0, 6.0), _way(50.0, -3.0, -7.0), _way(70.0, 2.0, 6.0)]
    seen = [np.linalg.inv(_MOUNT) @ way @ _MOUNT for way in ways]
    assert np.abs(hand_eye(ways, seen) - _MOUNT).max() < 1e-3


def test_hand_eye_keeps_the_height_that_a_plane_leaves_free():
    ways = [_way(60.0, 0.0, 6.0), _way(50.0, 0.0, -7.0)]
    level = _MOUNT.copy()
    level[:3, :3] = Rotation.from_euler("z", 170.0, degrees=True).as_matrix()
    found = hand_eye(ways, [np.linalg.inv(level) @ way @ level for way in ways])
    assert np.abs(found[:2, 3] - level[:2, 3]).max() < 1e-2
    assert abs(found[2, 3]) < 1e-2


def test_odometry_follows_a_short_way():
    pytest.importorskip("kiss_icp", reason="KISS-ICP is a peer of the measurements only")
    rng = np.random.default_rng(0)
    walls_m = rng.uniform([-10.0, -6.0, -2.0], [20.0, 6.0, 4.0], size=(20_000, 3))
    walls_m[:, 1] = np.sign(walls_m[:, 1]) * (6.0 + np.floor(walls_m[:, 0] / 3.0) % 2.0)
    walls_m[::3, 2] = -2.0
    walls_m[::3, 1] = rng.uniform(-6.0, 6.0, len(walls_m[::3]))
    frames = [((walls_m - [0.2 * step, 0.0, 0.0]).astype(np.float32), None) for step in range(6)]
    pose = follow(frames)
    assert pose[:3, 3] == pytest.approx([1.0, 0.0, 0.0], abs=0.1)
