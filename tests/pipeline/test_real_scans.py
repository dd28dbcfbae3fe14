# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.snapshot import LidarScans, Scan, Snapshot

_DATA = Path(__file__).parents[3] / "shared" / "data" / "opencalib-0001"
pytestmark = pytest.mark.skipif(
    not _DATA.is_dir(), reason="the real scans are not beside this checkout (../shared/data)"
)

# From the README of the real scans: xyz m, rpy deg; tolerances 0.02 m, 0.3 deg (yaw 0.4 deg).
_TRUTH = {
    "left": ([0.01, 0.57, -0.40], [-4.2, 45.1, 91.8]),
    "right": ([-0.03, -0.56, -0.43], [-0.5, 45.8, -86.1]),
}
_CONFIG = with_overrides(CalibrationConfig(), ["target=top"])


@pytest.fixture(scope="module")
def clouds():
    return {
        name: np.asarray(o3d.io.read_point_cloud(str(_DATA / f"{name}.pcd")).points)
        for name in ("top", "left", "right")
    }


def _snapshot(clouds, rotations):
    return Snapshot(
        tuple(LidarScans(name, (Scan(points @ rotations.get(name, np.eye(3)).T),)) for name, points in clouds.items())
    )


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_both_sides_are_found_from_any_orientation(clouds, seed):
    rotations = {}
    if seed is not None:
        rotations = {name: Rotation.random(random_state=seed).as_matrix() for name in ("left", "right")}
    result = calibrate(_snapshot(clouds, rotations), _CONFIG)
    assert result.status == "complete"
    for name, (xyz_m, rpy_deg) in _TRUTH.items():
        placed = result[name].T_target_source
        unturned = placed.rotation @ rotations.get(name, np.eye(3))
        found = RigidTransform.from_rotation_translation("top", name, unturned, placed.xyz_m)
        assert np.all(np.abs(found.xyz_m - xyz_m) <= 0.02 + 1e-9), (name, found.xyz_m)
        assert np.all(np.abs(found.rpy_deg - rpy_deg) <= [0.3, 0.3, 0.4]), (name, found.rpy_deg)


def test_one_thread_gives_the_same_bits(clouds):
    snapshot = _snapshot(clouds, {})
    first, second = (calibrate(snapshot, _CONFIG) for _ in range(2))
    for name in ("left", "right"):
        assert first[name].T_target_source.matrix.tobytes() == second[name].T_target_source.matrix.tobytes()
        assert first[name].fitness == second[name].fitness
