# SPDX-License-Identifier: Apache-2.0
"""Outlines of fields of view; uncertainties as ellipsoids."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform, turn_upwards
from multilica.results import CalibrationResult, LidarPlacement, PreprocessedCloud
from multilica.results.building import Provenance, result_document
from multilica.results.document import InputEntry, ResultDocument
from multilica.sinks.drawing import ellipsoid_scale, field_of_view, shown_field_of_view, uncertainty_ellipsoid
from multilica.sinks.run_state import RunState


def returns(azimuth_deg: tuple[float, float], elevation_deg: tuple[float, float]) -> np.ndarray:
    azimuth, elevation = np.meshgrid(np.linspace(*azimuth_deg, 60), np.linspace(*elevation_deg, 12))
    azimuth, elevation = np.deg2rad(azimuth.ravel()), np.deg2rad(elevation.ravel())
    directions = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    return directions * np.linspace(2.0, 40.0, len(directions))[:, None]


def angles_deg(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    azimuth = np.arctan2(outline[:, 1], outline[:, 0])
    return np.rad2deg(azimuth), np.rad2deg(np.arcsin(outline[:, 2] / np.linalg.norm(outline, axis=1)))


def test_a_narrow_lidar_has_one_closed_outline_at_its_own_limits():
    outline, *rays = field_of_view(returns((-60.0, 60.0), (-10.0, 15.0)), radius_m=2.0)
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 2.0, rtol=1e-5)
    np.testing.assert_allclose(outline[0], outline[-1], atol=1e-6)
    azimuth, elevation = angles_deg(outline)
    np.testing.assert_allclose([azimuth.min(), azimuth.max()], [-60.0, 60.0], atol=0.1)
    np.testing.assert_allclose([elevation.min(), elevation.max()], [-10.0, 15.0], atol=0.1)
    assert all(not ray[0].any() for ray in rays)


def test_an_outline_may_cross_the_seam_of_azimuths():
    outline, *_ = field_of_view(returns((150.0, 210.0), (-5.0, 5.0)))
    azimuth, _ = angles_deg(outline)
    assert np.all(np.abs(azimuth) > 149.0)


def test_a_spinning_lidar_has_a_circle_at_either_end():
    low, high, *_ = field_of_view(returns((-180.0, 177.0), (-20.0, 12.0)))
    for circle, expected in ((low, -20.0), (high, 12.0)):
        np.testing.assert_allclose(angles_deg(circle)[1], expected, atol=0.1)


@pytest.mark.parametrize("limits_deg", [(-60.0, 60.0), (-180.0, 177.0)])
def test_an_outline_turns_with_the_frame_of_the_sensor(limits_deg):
    seen_m, upwards = returns(limits_deg, (-20.0, 12.0)), turn_upwards(np.array([1.0, 0.0, 0.0]))
    expected = field_of_view(seen_m)
    found = field_of_view(seen_m @ upwards, np.array([1.0, 0.0, 0.0]))
    for strip, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(strip @ upwards.T, other, atol=1e-6)


def test_the_shown_outline_has_the_axis_of_the_cloud():
    upwards, state = turn_upwards(np.array([1.0, 0.0, 0.0])), RunState()
    seen_m = returns((-180.0, 177.0), (-20.0, 12.0)) @ upwards
    state.clouds["front"] = PreprocessedCloud("front", seen_m, seen_m, elevation_axis=upwards[2])
    low, high, *_ = shown_field_of_view(state, "front")
    np.testing.assert_allclose(np.ptp(low[:, 0]), 0.0, atol=1e-6)
    assert low[0, 0] < 0.0 < high[0, 0]


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((5, 3)), np.tile([[1.0, 0.0, 0.0]], (9, 1))])
def test_returns_that_span_nothing_have_no_outline(points):
    assert field_of_view(points) == ()


def test_of_two_equal_gaps_rounding_chooses_none():
    ahead, behind = returns((-40.0, 40.0), (-5.0, 5.0)), returns((140.0, 220.0), (-5.0, 5.0))
    starts = []
    for turned_deg in (-1e-9, 1e-9):
        turn = Rotation.from_euler("z", turned_deg, degrees=True).as_matrix()
        starts.append(field_of_view(np.concatenate([ahead, behind @ turn.T]))[0][0])
    np.testing.assert_allclose(*starts, atol=1e-6)


def document_with(*placements: LidarPlacement) -> ResultDocument:
    target = LidarPlacement("top", "the target", "placed", RigidTransform.identity("top", "top"))
    source = InputEntry(source="", sha256="", lidars={})
    result = CalibrationResult("top", "", (*placements, target))
    return result_document(result, CalibrationConfig(), Provenance({}, source))


@pytest.mark.parametrize("seed", range(5))
def test_axes_have_fixed_signs_and_are_right_handed(seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    covariance = np.eye(6)
    covariance[3:, 3:] = turn @ np.diag([1e-6, 4e-6, 9e-6]) @ turn.T
    pose = RigidTransform.identity("top", "rear")
    place = LidarPlacement("rear", "placed", "placed", T_target_source=pose, covariance=covariance)
    half_sizes_m, axes = uncertainty_ellipsoid(document_with(place), "rear")
    np.testing.assert_allclose(half_sizes_m, [3e-3, 6e-3, 9e-3])
    np.testing.assert_allclose(np.abs(np.diag(turn.T @ axes.rotation)), 1.0)
    assert all(axis[np.argmax(np.abs(axis))] > 0.0 for axis in axes.rotation.T[:2])


@pytest.mark.parametrize(
    ("sigma_m", "scale"), [(0.001, 50.0), (0.0066, 50.0), (0.0068, 20.0), (0.03, 10.0), (0.3, 1.0), (3.0, 1.0)]
)
def test_ellipsoids_are_enlarged_as_far_as_the_largest_allows(sigma_m, scale):
    pose = RigidTransform.identity("top", "rear")
    small, large = (
        LidarPlacement(name, "", "placed", pose, covariance=np.eye(6) * each**2)
        for name, each in (("front", 1e-3), ("rear", sigma_m))
    )
    assert ellipsoid_scale(document_with(small, large)) == scale
    assert ellipsoid_scale(document_with(LidarPlacement("rear", "no pose"))) == 50.0
