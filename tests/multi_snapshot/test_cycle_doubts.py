# SPDX-License-Identifier: Apache-2.0
"""A cycle that does not close within snapshots widens the joint covariance."""

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun, join
from multilica.multi_snapshot.estimate import chained
from multilica.results import CalibrationResult, LidarPlacement, PairRegistration
from multilica.stages.refine import refine

_SIGMA = np.array([1e-4] * 3 + [2e-3] * 3)
_INFORMATION = np.diag(_SIGMA**-2.0)
_TRUTH = {
    name: RigidTransform.from_xyz_rpy("T", name, [index, -0.5 * index, 0.0], [0.0, 0.0, -index])
    for index, name in enumerate("TAB")
}
_CONFIG = CalibrationConfig(target="T")
_OFF_M = 0.03


def _pair(target, source, rng, off_m):
    pose = _TRUTH[target].inverse() @ _TRUTH[source]
    xyz_m = pose.xyz_m + [off_m, 0.0, 0.0] + 2e-3 * rng.normal(size=3)
    measured = RigidTransform.from_rotation_translation(target, source, pose.rotation, xyz_m)
    return PairRegistration(
        target, source, measured, 0.9, 0.05, 1000, converged=True, iterations=5, engine="", information=_INFORMATION
    )


def _run(seed, off_m):
    """A snapshot of three LiDARs, of which the pair A with B is off."""
    rng = np.random.default_rng(seed)
    pairs = (_pair("T", "A", rng, 0.0), _pair("T", "B", rng, 0.0), _pair("A", "B", rng, off_m))
    refinement = refine("T", chained("T", pairs), pairs, _CONFIG.refine).refinement
    placements = tuple(LidarPlacement(name, "alone", "placed", pose) for name, pose in _TRUTH.items())
    result = CalibrationResult("T", "", placements, refinement=refinement, trusted=pairs)
    return SnapshotRun(f"s{seed}", result, f"s{seed}.mcap", f"{seed:064x}")


def _joined(*offs_m):
    return join([_run(seed, off_m) for seed, off_m in enumerate(offs_m)], _CONFIG)


@pytest.mark.parametrize("count", [2, 4])
def test_an_error_that_all_snapshots_have_is_covered(count):
    """A LiDAR that is off by its own errors is so in each of them."""
    result = _joined(*[_OFF_M] * count)
    for lidar in "AB":
        place = result[lidar]
        error_m = place.T_target_source.offset_from(_TRUTH[lidar])[3:]
        assert np.abs(error_m).max() > 2e-3
        assert (np.abs(error_m) < 3.0 * place.sigma_xyz_m).all()
        assert 0.02 < place.sigma_xyz_m.max() < 0.045
        assert place.status == "uncertain"
        assert "sigma covers that in s" in place.reason
        assert "contradicts the other pairs of its cycle by" in place.reason


def test_an_error_of_one_snapshot_counts_by_its_share():
    sigmas_m = [_joined(*[_OFF_M] * off, *[0.0] * (4 - off))["A"].sigma_xyz_m.max() for off in (0, 1, 2, 4)]
    assert sigmas_m[0] < 3e-3
    assert sigmas_m[1] == pytest.approx(0.25 * sigmas_m[3], rel=0.3)
    assert sigmas_m[2] == pytest.approx(0.5 * sigmas_m[3], rel=0.3)


def test_cycles_that_close_widen_nothing():
    result = _joined(0.0, 0.0)
    assert all(result[lidar].status == "placed" for lidar in "AB")
    assert not any("sigma covers" in place.reason for place in result.placements)
