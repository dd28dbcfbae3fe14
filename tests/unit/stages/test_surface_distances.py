# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import FineConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.stages.surface_distances import match_surfaces, residuals_of

_CONFIG = FineConfig(voxel_size_m=0.01)
_TRUTH = RigidTransform.from_xyz_rpy("t", "s", [1.0, -0.5, 0.2], [0.1, 0.05, 0.7])


def _floor(low_m, high_m, height_m=0.0, step_m=0.2):
    x, y = np.meshgrid(np.arange(low_m, high_m, step_m), np.arange(-3.0, 3.0, step_m))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])


def _clouds(target_m, source_m):
    """Both clouds are given in the target's frame."""
    in_source = _TRUTH.inverse().apply(source_m)
    return prepare_gicp_cloud("t", target_m, _CONFIG), prepare_gicp_cloud("s", in_source, _CONFIG)


def test_the_residual_is_the_distance_to_the_plane():
    target, source = _clouds(_floor(0.0, 6.0), _floor(0.07, 6.0, height_m=0.03))
    found, _ = match_surfaces(target, source, _TRUTH, 0.25, 10**6)
    assert len(found) == len(source.points_m)
    assert found.plane_distance_m == pytest.approx(0.03, abs=1e-9)
    assert np.all(found.distance_m > 0.03)
    again_m = np.linalg.norm(_TRUTH.apply(found.source_points_m) - found.target_points_m, axis=1)
    assert again_m == pytest.approx(found.distance_m)


def test_points_beyond_the_distance_do_not_match():
    target, source = _clouds(_floor(0.0, 3.0), _floor(2.0, 6.0))
    found, rows = match_surfaces(target, source, _TRUTH, 0.25, 10**6)
    matched_m = _TRUTH.apply(source.points_m[rows])
    assert 0 < len(found) < len(source.points_m)
    assert matched_m[:, 0].max() < 3.0 + 0.25
    assert np.array_equal(found.source_points_m, source.points_m[rows])


def test_of_many_points_some_are_matched_evenly():
    target, source = _clouds(_floor(0.0, 6.0), _floor(0.0, 6.0))
    found, rows = match_surfaces(target, source, _TRUTH, 0.25, 100)
    assert len(found) == 100
    assert (rows[0], rows[-1]) == (0, len(source.points_m) - 1)


def test_a_residual_is_the_smallest_to_any_lidar():
    near, source = _clouds(_floor(0.0, 3.0, height_m=0.01), _floor(0.0, 6.0))
    far, _ = _clouds(_floor(0.0, 6.0, height_m=-0.04), _floor(0.0, 6.0))
    residuals = residuals_of(source, [match_surfaces(each, source, _TRUTH, 0.25, 10**6) for each in (near, far)])
    along_m = _TRUTH.apply(residuals.points_m)[:, 0]
    assert residuals.lidar == "s"
    assert len(residuals.points_m) == len(source.points_m)
    assert residuals.residual_m[along_m < 2.7] == pytest.approx(0.01, abs=1e-9)
    assert residuals.residual_m[along_m > 3.3] == pytest.approx(0.04, abs=1e-9)


def test_a_lidar_that_meets_no_other_has_no_residuals():
    target, source = _clouds(_floor(0.0, 3.0), _floor(20.0, 23.0))
    residuals = residuals_of(source, [match_surfaces(target, source, _TRUTH, 0.25, 10**6)])
    assert residuals.points_m.shape == (0, 3)
    assert residuals.residual_m.shape == (0,)
