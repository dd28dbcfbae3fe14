# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.geometry import Z_AXIS
from multilica.registration import sensor_biases
from multilica.solvers import ground_surface
from multilica.solvers.ground_surface import axes_of, fit_surface

WHEELS_M = (1.4, 0.8)


def _fitted(height_m, noise_m=0.005, nearest_m=2.0, bias_sigmas=(1e-6, 1e-6)):
    """The surface of points around a vehicle whose middle is 2 m above the ground."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-12, 12, (2, 4_000))
    points_m = np.stack([x, y, height_m(x, y) - 2.0 + rng.normal(0, noise_m, len(x))], axis=1)
    points_m = points_m[np.hypot(x, y) > nearest_m]
    axes = axes_of(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.2, 0.3]))
    return fit_surface(points_m, np.zeros(3), axes, 2.0, WHEELS_M, 0.05, np.array(bias_sigmas))


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


@pytest.mark.parametrize("lidar_m", [2.0, 1.2])
def test_biases_of_range_and_elevation_lift_the_ground(lidar_m):
    """By as much as the points of a LiDAR over the middle, or not far below it."""
    places_m = np.random.default_rng(1).uniform(-12, 12, (200, 2))
    points_m = np.column_stack([places_m, np.full(200, -lidar_m)])
    shifts = sensor_biases.shifts_per_bias(points_m, points_m, Z_AXIS)[:2, :, 2].T
    found = ground_surface._by_biases(places_m, lidar_m)
    beyond = np.hypot(*places_m.T) > (0.0 if lidar_m >= ground_surface._SENSOR_HEIGHT_M else 3.0)
    np.testing.assert_allclose(found[beyond], shifts[beyond], atol=1e-9 if np.all(beyond) else 0.05)


def test_biases_that_may_be_widen_the_sigma():
    unbiased, biased = (
        _fitted(lambda x, _: 0.0 * x, bias_sigmas=sigmas) for sigmas in ((1e-9, 1e-9), (0.02, np.deg2rad(0.03)))
    )
    assert biased.sigma_z_m > 1.5 * unbiased.sigma_z_m
    assert biased.offset_m == pytest.approx(2.0, abs=2.0 * biased.sigma_z_m)


def test_ground_of_biased_ranges_is_within_its_sigma():
    """All ranges of a LiDAR 2 m above it are 3 cm too long: the ground is up to 3 cm too low."""

    def lowered(x, y):
        return -0.03 * 2.0 / np.sqrt(x**2 + y**2 + 4.0)

    known, unknown = (_fitted(lowered, bias_sigmas=sigmas) for sigmas in ((0.02, 3e-4), (1e-9, 1e-9)))
    off_m = abs(known.offset_m - 2.0)
    assert off_m < 3.0 * known.sigma_z_m
    assert off_m > 3.0 * unknown.sigma_z_m
    assert known.offset_m == unknown.offset_m
