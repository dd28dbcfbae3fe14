# SPDX-License-Identifier: Apache-2.0
"""A vehicle that hardly moves adds to the covariance of LiDARs that measured at different times."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.pipeline import calibrate
from multilica.results import BiasInformation
from multilica.simulate import simulate_snapshot, simulation
from multilica.snapshot import LidarScans, Scan
from multilica.stages.slow_motion import SlowMotion, slow_motion_of
from multilica.verification import register_from_known
from tests.unit.acceptance.made_rig import linked

_BEGIN_NS = 10**18
_EMPTY = np.zeros((0, 3), np.float32)


def _lidar(name, times_s, logged=False):
    times_ns = [_BEGIN_NS + round(1e9 * time_s) for time_s in times_s]
    scans = (Scan(_EMPTY, log_time_ns=each) if logged else Scan(_EMPTY, each) for each in times_ns)
    return LidarScans(name, tuple(scans))


@pytest.mark.parametrize("logged", [False, True])
def test_the_way_between_the_mean_times_is_added(logged):
    lidars = [_lidar("a", [0.0, 0.1, 0.2], logged), _lidar("b", [0.2], logged), _lidar("c", [0.0, 0.2], logged)]
    found = slow_motion_of(lidars, {"a": (0.02, 0.004), "b": (0.0, 0.0), "c": (0.02, 0.004)})
    covariance = np.diag(np.repeat([0.002, 0.01], 3) ** 2)
    np.testing.assert_allclose(found.covariance("a", "b"), covariance)
    np.testing.assert_allclose(found.covariance("b", "a"), covariance)
    np.testing.assert_allclose(found.covariance("a", "c"), 0.0, atol=1e-30)
    np.testing.assert_allclose(found.added_to({"b": np.eye(6)}, "a")["b"], np.eye(6) + covariance)


def test_it_is_in_the_covariance_of_pairs_for_joint_results():
    """With biases, marginalised, and without; the biases themselves are known as well as before."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((14, 20))
    joint = root @ root.T * 1e4
    found = BiasInformation(joint, rng.standard_normal(14), joint, 0.5 * joint, np.zeros(8))
    pair = replace(linked("a", "b"), information=np.linalg.inv(np.linalg.inv(joint)[:6, :6]), bias_information=found)
    slow = SlowMotion(0.1, 0.02, {"a": 0.0, "b": 0.2}, 1.0)
    after = slow.added_to_pair(pair)
    added = np.diag(np.repeat([0.004, 0.02], 3) ** 2)
    np.testing.assert_allclose(np.linalg.inv(after.information), np.linalg.inv(pair.information) + added, rtol=1e-6)
    covariance = np.linalg.inv(joint)
    covariance[:6, :6] += added
    np.testing.assert_allclose(np.linalg.inv(after.bias_information.information), covariance, atol=1e-9)
    np.testing.assert_allclose(after.bias_information.spread, after.bias_information.information, rtol=1e-6)
    assert SlowMotion().added_to_pair(pair) is pair
    loose = replace(pair, information=np.diag([0.0, 1e6, 1e6, 1e4, 1e4, 0.0]), bias_information=None)
    widened = slow.added_to_pair(loose).information
    np.testing.assert_allclose(np.diag(widened)[[0, 3, 5]], [0.0, 1.0 / (1e-4 + 0.02**2), 0.0], atol=1e-6)
    assert SlowMotion(1e-5, 1e-6, slow.times_s, 1.0).added_to_pair(pair) is pair


def test_most_lidars_tell_the_speed():
    """One of three was misled."""
    times_s = [0.0, 0.5]
    motions = {"a": (0.01, 0.0), "b": (0.02, 0.0), "c": (0.5, 0.0)}
    found = slow_motion_of([_lidar(name, times_s) for name in motions], motions)
    assert found.speed_m_s == pytest.approx(0.04)


def test_clocks_that_differ_count_as_far_as_the_frames_reach():
    lidars = [_lidar("a", [0.0, 0.4]), _lidar("b", [0.1, 0.5])]
    assert slow_motion_of(lidars, dict.fromkeys("ab", (0.04, 0.0))).span_s == pytest.approx(0.5)
    apart = SlowMotion(0.1, 0.0, {"a": 0.0, "b": 37.0}, 0.5)
    assert np.sqrt(apart.covariance("a", "b")[3, 3]) == pytest.approx(0.05)


def test_without_times_nothing_is_added():
    found = slow_motion_of([_lidar("a", [0.0, 0.4]), LidarScans("b", (Scan(_EMPTY),))], {"a": (0.04, 0.0)})
    assert found == SlowMotion()
    assert not np.any(found.covariance("a", "b"))
    assert slow_motion_of([], {}) == SlowMotion()


@pytest.mark.slow
def test_a_creeping_vehicle_leaves_poses_within_their_sigma(monkeypatch):
    """The vehicle creeps by 4 cm, and one LiDAR has the last of five frames only."""
    monkeypatch.setattr(simulation, "_SPEED_M_S", 0.1)
    made = simulate_snapshot("sides", "street", 3, frames=5, disturbances=("moving",))
    first, *others = made.snapshot.lidars
    snapshot = replace(made.snapshot, lidars=(replace(first, scans=first.scans[-1:]), *others))
    config = CalibrationConfig(runtime={"workers": 1})
    for result in (calibrate(snapshot, config), register_from_known(snapshot, made.truth, config)):
        known = made.truth.between(result.target, first.name)
        off = result[first.name].T_target_source.offset_from(known)
        assert np.linalg.norm(off[3:]) > 0.01
        assert off @ np.linalg.solve(result[first.name].covariance, off) < 22.5
