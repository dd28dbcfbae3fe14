# SPDX-License-Identifier: Apache-2.0
"""Fits of two LiDARs of 16 rings, and poses where only their rings meet."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig, RefineConfig
from multilica.geometry import Z_AXIS, RigidTransform
from multilica.registration import plane_settling
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.plane_fit import fit_planes
from multilica.registration.poses import moved
from multilica.registration.sensor_biases import prior_sigmas
from multilica.simulate.sensors import SpinningPattern

_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
_LOWEST_M, _HIGHEST_M = np.array([-9.0, -6.0, -1.1]), np.array([11.0, 8.0, 3.0])
_TRUTH = RigidTransform.from_xyz_rpy("t", "s", (0.02, 0.03, 0.02), np.deg2rad([3.0, -2.0, 17.0]))


def _seen(name, pose, channels, seed):
    """What a LiDAR sees of a room, in its own frame; its ranges are noisy."""
    rng = np.random.default_rng(seed)
    directions = SpinningPattern(channels, 1800, (-15.0, 15.0)).directions(0, rng)
    turned = pose.rotate(directions)
    with np.errstate(divide="ignore"):
        ranges_m = (np.where(turned > 0.0, _HIGHEST_M, _LOWEST_M) - pose.xyz_m) / turned
    noisy_m = ranges_m.min(axis=1) + rng.normal(0.0, 0.018, len(directions))
    return prepare_gicp_cloud(name, directions * noisy_m[:, None], FineConfig())


def _clouds(channels):
    return _seen("t", RigidTransform.identity("t", "t"), channels, 1), _seen("s", _TRUTH, channels, 2)


def _fitted_from(turn_deg, clouds):
    """How far from the truth in degrees a fit ends that begins turned about the axes of the source."""
    start = _TRUTH @ moved(RigidTransform.identity("s", "s"), np.deg2rad(turn_deg), np.zeros(3))
    return np.rad2deg(fit_planes(*clouds, start, _SIGMAS).pose.distance_to(_TRUTH)[1])


def test_only_few_rings_are_sparse():
    assert all(cloud.is_sparse for cloud in _clouds(16))
    assert not any(cloud.is_sparse for cloud in _clouds(64))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("turn_deg", [0.0, 0.8])
def test_a_fit_in_a_room_ends_at_the_truth(axis, turn_deg):
    assert _fitted_from(turn_deg * np.eye(3)[axis], _clouds(16)) < 0.1


def _turned(x_deg, y_deg=0.0):
    return _TRUTH @ moved(RigidTransform.identity("s", "s"), np.deg2rad([x_deg, y_deg, 0.0]), np.zeros(3))


@pytest.fixture
def ends(monkeypatch):
    """Let fits end at the nearest of some poses (x deg, y deg, usual residual, matches), or nowhere near.

    Fits of all points may end at another one.
    """

    def settle_at(*wells, of_all=None):
        def settle(target, source, start, bias_sigmas, *, roughly=False):
            del target, source, bias_sigmas
            if of_all is not None and not roughly:
                return _ended(*of_all)
            turns_rad = [start.distance_to(_turned(*well[:2]))[1] for well in wells]
            nearest = int(np.argmin(turns_rad))
            return _ended(*wells[nearest]) if turns_rad[nearest] < np.deg2rad(0.5) else None

        monkeypatch.setattr(plane_settling, "settle", settle)

    return settle_at


def _ended(x_deg, y_deg, sigma_m, matches):
    residuals = SimpleNamespace(sigma_m=sigma_m, rows=range(matches))
    return plane_settling.Settled(None, _turned(x_deg, y_deg), np.zeros(8), residuals)


def _ends_at(first):
    source = SimpleNamespace(elevation_axis=Z_AXIS)
    found = plane_settling.settle_beside_lines(None, source, _ended(*first), _SIGMAS).pose
    return np.rad2deg(found.distance_to(_TRUTH)[1])


_LOCKED = (1.0, 0.0, 0.03, 1200)


@pytest.mark.parametrize("first", [_LOCKED, (0.4, 0.0, 0.025, 1100), (0.0, -1.1, 0.04, 1000)])
def test_the_smaller_residuals_of_the_truth_win(ends, first):
    ends((0.0, 0.0, 0.02, 1000), first)
    assert _ends_at(first) == pytest.approx(0.0, abs=1e-6)


def test_a_way_of_two_turns_is_gone(ends):
    ends((0.0, 0.0, 0.02, 1000), (0.0, 1.0, 0.026, 1100), (1.0, 1.0, 0.035, 1200))
    assert _ends_at((1.0, 1.0, 0.035, 1200)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("elevation_axis", [*np.eye(3), np.array([0.6, 0.0, -0.8])])
def test_turns_are_across_the_scan_lines(elevation_axis):
    turned = [_TRUTH.inverse() @ each for each in plane_settling._turned(_TRUTH, elevation_axis)]
    axes = np.array([Rotation.from_matrix(each.rotation).as_rotvec() for each in turned])
    assert axes @ elevation_axis == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.matrix_rank(axes, tol=1e-6) == 2


@pytest.mark.parametrize("other", [(0.0, 0.0, 0.029, 1200), (0.0, 0.0, 0.01, 300)], ids=["alike", "few matches"])
def test_other_poses_do_not(ends, other):
    ends(other, _LOCKED)
    assert _ends_at(_LOCKED) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("of_all", [(0.6, 0.0, 0.03, 1200), (4.0, 0.0, 0.01, 1000)], ids=["locked again", "strayed"])
def test_a_rough_fit_that_all_points_deny_does_not(ends, of_all):
    ends((0.0, 0.0, 0.02, 1000), _LOCKED, of_all=of_all)
    assert _ends_at(_LOCKED) == pytest.approx(1.0, abs=1e-6)


def test_a_fit_that_strays_does_not(monkeypatch):
    """Matches reach 0.2 m, so what ends farther from its start was led there by chance."""

    def settle(target, source, start, bias_sigmas, *, roughly=False):
        del target, source, bias_sigmas, roughly
        return _ended(*_LOCKED) if start.distance_to(_turned(1.0))[1] < 1e-3 else _ended(4.0, 0.0, 0.005, 1200)

    monkeypatch.setattr(plane_settling, "settle", settle)
    assert _ends_at(_LOCKED) == pytest.approx(1.0, abs=1e-6)


def test_a_rough_fit_takes_fewer_points_and_ends_near_by():
    rough, full = (plane_settling.settle(*_clouds(64), _TRUTH, _SIGMAS, roughly=roughly) for roughly in (True, False))
    assert len(rough.overlap.points_m) == 2_000 < len(full.overlap.points_m)
    assert rough.pose.distance_to(full.pose)[0] < 0.005
