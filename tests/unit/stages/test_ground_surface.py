# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.stages.ground import axes_of, fit_surface

WHEELS_M = (1.4, 0.8)


def _fitted(height_m, noise_m=0.005, nearest_m=2.0):
    """The surface of points around a vehicle whose middle is 2 m above the ground."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-12, 12, (2, 4_000))
    points_m = np.stack([x, y, height_m(x, y) - 2.0 + rng.normal(0, noise_m, len(x))], axis=1)
    points_m = points_m[np.hypot(x, y) > nearest_m]
    axes = axes_of(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.2, 0.3]))
    return fit_surface(points_m, np.zeros(3), axes, 2.0, WHEELS_M, 0.05)


def test_axes_are_right_handed_and_in_the_plane():
    normal = np.array([0.6, 0.0, 0.8])
    axes = axes_of(normal, np.array([1.0, 0.5, 0.0]))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0] @ [1.0, 0.5, 0.0] > 0.0


def test_a_slope_is_the_tilt_of_the_plane():
    found = _fitted(lambda x, y: 0.02 * x - 0.01 * y)
    np.testing.assert_allclose(
        found.normal, np.array([-0.02, 0.01, 1.0]) / np.linalg.norm([0.02, 0.01, 1.0]), atol=5e-4
    )
    assert found.offset_m == pytest.approx(2.0, abs=2e-3)
    assert found.residual_m == pytest.approx(0.005, abs=1e-3)


def test_the_plane_goes_through_the_wheels_on_a_curve():
    found = _fitted(lambda x, _: 0.0008 * x**2)
    assert found.offset_m == pytest.approx(2.0 - 0.0008 * WHEELS_M[0] ** 2, abs=1.5e-3)


def test_ground_that_is_not_seen_widens_the_sigma():
    near, far = (_fitted(lambda x, _: 0.0 * x, nearest_m=nearest_m) for nearest_m in (2.0, 9.0))
    assert far.sigma_z_m > near.sigma_z_m
    assert far.score < near.score


def test_points_below_the_surface_count_against_it():
    whole = _fitted(lambda x, _: 0.0 * x)
    holed = _fitted(lambda x, _: np.where(x > 6.0, -0.5, 0.0))
    assert holed.score < 0.8 * whole.score
    assert whole.below == 0.0
    assert holed.below > 0.02
