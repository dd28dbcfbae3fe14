# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.fleet.lidar_series import LidarSeries
from multilica.geometry import RigidTransform

_POSE = RigidTransform.from_xyz_rpy("top", "left", [1.0, 2.0, 3.0], [0.0, 0.0, 0.1])
_GOOD = {
    "vehicle": "v01",
    "lidar": "left",
    "target": "top",
    "keys": ("a", "b"),
    "time_ns": np.array([1, 1]),
    "T_target_lidar": (_POSE, _POSE),
    "covariances": np.tile(np.eye(6), (2, 1, 1)),
}


def test_rotations_become_lengths_at_the_lever_arm():
    moved = RigidTransform.from_xyz_rpy("top", "left", [1.0, 2.5, 3.0], [0.0, 0.0, 0.12])
    series = LidarSeries(**{**_GOOD, "T_target_lidar": (_POSE, moved)})
    np.testing.assert_allclose(series.offsets(_POSE)[1], [0.0, 0.0, 0.2, 0.0, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.diag(series.scaled_covariances()[0]), [100.0] * 3 + [1.0] * 3)
    assert not series.time_ns.flags.writeable


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"keys": ("a",)}, "expected 1 times"),
        ({"time_ns": np.array([2, 1])}, "not in order of time"),
        ({"covariances": np.full((2, 6, 6), np.inf)}, "not finite"),
        ({"covariances": np.where(np.eye(6) > 0.0, 1.0, np.nan) * np.ones((2, 1, 1))}, "not finite"),
        ({"target": "rear"}, "other frames"),
    ],
)
def test_wrong_series_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        LidarSeries(**{**_GOOD, **wrong})


def test_a_log_without_a_covariance_does_not_count_for_drift():
    covariances = np.stack([np.full((6, 6), np.nan), np.eye(6)])
    series = LidarSeries(**{**_GOOD, "covariances": covariances, "sources": ("one", "other")})
    known = series.with_known_covariances()
    assert (known.keys, len(series)) == (("b",), 2)
    assert np.isnan(series.sigmas()[0]).all()
    assert np.isfinite(series.sigmas()[1]).all()
