# SPDX-License-Identifier: Apache-2.0
"""The uncertainty of a position as an ellipsoid."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.sinks.drawing.ellipsoid import uncertainty_ellipsoid


@pytest.mark.parametrize("seed", range(5))
def test_axes_have_fixed_signs_and_are_right_handed(seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    covariance = np.eye(6)
    covariance[3:, 3:] = turn @ np.diag([1e-6, 4e-6, 9e-6]) @ turn.T
    pose = RigidTransform.identity("top", "rear")
    place = LidarPlacement("rear", "placed", placed=True, T_target_source=pose, covariance=covariance)
    half_sizes_m, axes = uncertainty_ellipsoid(place)
    np.testing.assert_allclose(half_sizes_m, [3e-3, 6e-3, 9e-3])
    np.testing.assert_allclose(np.abs(np.diag(turn.T @ axes.rotation)), 1.0)
    assert all(axis[np.argmax(np.abs(axis))] > 0.0 for axis in axes.rotation.T[:2])
