# SPDX-License-Identifier: Apache-2.0
"""Fitness, spread and target of joint results, from made registrations in which no two numbers are alike."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun, join
from multilica.multi_snapshot.estimate import Estimate, chance_of_difference, scatter_ratio, spread_of
from multilica.multi_snapshot.join import choose_target
from multilica.results import CalibrationResult, LidarPlacement, PairRegistration

_POSE = RigidTransform.from_xyz_rpy("T", "A", [1.0, -2.0, 0.5], [0.3, -0.7, 2.0])
_SIGMAS = np.array([1e-4, 2e-4, 3e-4, 2e-3, 3e-3, 4e-3])
_OFFSETS = np.array(
    [
        [0.002, -0.001, 0.004, 0.010, -0.020, 0.007],
        [-0.001, 0.003, 0.001, 0.030, 0.010, -0.002],
        [0.005, 0.002, -0.003, -0.020, 0.040, 0.021],
    ]
)


_SCALES = np.array([1.0, 3.0, 0.5])


def _moved(offset):
    turn = Rotation.from_rotvec(offset[:3]).as_matrix() @ _POSE.rotation
    return RigidTransform.from_rotation_translation("T", "A", turn, _POSE.xyz_m + offset[3:])


def _pair(target, source, fitness, rmse_m=0.1, pose=None):
    pose = pose or RigidTransform.identity(target, source)
    return PairRegistration(
        target, source, pose, fitness, rmse_m, 9, converged=True, iterations=1, engine="", information=np.eye(6) * 1e6
    )


def _snapshot(name, pairs):
    lidars = sorted({lidar for pair in pairs for lidar in pair.lidars})
    alone = tuple(LidarPlacement(lidar, "alone") for lidar in lidars)
    return SnapshotRun(name, CalibrationResult("T", "", alone, trusted=tuple(pairs)), f"{name}.mcap", "")


def test_fitness_and_rmse_are_those_of_the_best_pair():
    """Evidence without verification is the fitness."""
    runs = [
        _snapshot("one", [_pair("T", "A", 0.61, 0.041, _POSE), _pair("B", "T", 0.55, 0.067)]),
        _snapshot("two", [_pair("T", "A", 0.74, 0.053, _POSE), _pair("B", "T", 0.48, 0.032)]),
        _snapshot("three", [_pair("T", "A", 0.68, 0.029, _POSE), _pair("B", "T", 0.51, 0.075)]),
    ]
    result = join(runs)
    assert result.target == "T"
    figures = {place.lidar: (place.fitness, place.rmse_m) for place in result.placements}
    assert figures == {"A": (0.74, 0.053), "B": (0.55, 0.067), "T": (1.0, 0.0)}


def test_the_spread_is_the_sample_deviation_by_axis():
    spread = spread_of([Estimate(_moved(offset), np.diag(_SIGMAS**2)) for offset in _OFFSETS])
    assert spread.snapshots == 3
    # The offsets are from the first estimate, so turns of milliradians add up to a millionth.
    assert spread.xyz_m == pytest.approx(np.std(_OFFSETS[:, 3:], axis=0, ddof=1))
    assert spread.rotation_deg == pytest.approx(np.degrees(np.std(_OFFSETS[:, :3], axis=0, ddof=1)), rel=5e-3)


def _estimates(size):
    """Three estimates with the scatter of the offsets, and with covariances of that size."""
    return [
        Estimate(_moved(offset), np.diag((size * scale * _SIGMAS) ** 2))
        for offset, scale in zip(_OFFSETS, _SCALES, strict=True)
    ]


def test_the_scatter_is_chi_squared_about_the_weighted_mean():
    size = 0.1
    weights = np.outer((size * _SCALES) ** -2.0, _SIGMAS**-2.0)
    mean = (weights * _OFFSETS).sum(axis=0) / weights.sum(axis=0)
    squared = (weights * (_OFFSETS - mean) ** 2).sum(axis=0) / 2.0
    expected = np.sqrt(np.maximum(squared, squared.mean()))
    assert scatter_ratio(_estimates(size)) == pytest.approx(expected, rel=5e-3)
    alike = [replace(each, pose=_POSE) for each in _estimates(size)]
    assert np.array_equal(scatter_ratio(alike), np.ones(6))


def test_a_scatter_that_chance_explains_widens_nothing():
    """Two degrees of freedom: chi squared above 13.8 has a probability of 0.001."""
    largest = scatter_ratio(_estimates(0.1)).max()
    limit = 0.1 * largest / np.sqrt(chi2.isf(0.001, 2) / 2.0)
    assert np.array_equal(scatter_ratio(_estimates(1.01 * limit)), np.ones(6))
    assert scatter_ratio(_estimates(0.99 * limit)).max() == pytest.approx(np.sqrt(chi2.isf(0.001, 2) / 2.0) / 0.99)


@pytest.mark.parametrize("seed", range(8))
def test_a_contradiction_in_any_direction_widens(seed):
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(6)
    offset = np.sqrt(2.0 * 30.0) * _SIGMAS * direction / np.linalg.norm(direction)
    estimates = [Estimate(_moved(each), np.diag(_SIGMAS**2)) for each in (np.zeros(6), offset)]
    assert chance_of_difference(*estimates) < 1e-3
    assert scatter_ratio(estimates).min() == pytest.approx(np.sqrt(30.0 / 6.0), rel=0.02)


@pytest.mark.parametrize(
    ("snapshots", "target"),
    [
        # First in two snapshots beats the larger sum.
        ({"one": ["AB 0.5", "AC 0.4"], "two": ["AB 0.5", "AC 0.4"], "three": ["BC 0.9", "BD 0.9", "BA 0.9"]}, "A"),
        # As often first: the larger sum.
        ({"one": ["AB 0.3", "AC 0.3"], "two": ["BC 0.8", "BD 0.7"]}, "B"),
        # The source counts as the target does.
        ({"one": ["AD 0.4", "BD 0.4", "CD 0.4"]}, "D"),
        # Nothing tells them apart: the first name.
        ({"one": ["BC 0.4"]}, "B"),
        ({"one": []}, "A"),
    ],
)
def test_the_target_is_first_in_the_most_snapshots(snapshots, target):
    pairs = {
        name: tuple(_pair(edge[0], edge[1], float(edge[3:])) for edge in edges) for name, edges in snapshots.items()
    }
    assert choose_target(pairs, "ABCD", "")[0] == target
    assert choose_target(pairs, "ABCD", "C") == ("C", "set by --target")
