# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.config import FineConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.stages.information import pose_information
from multilica.stages.registration_cloud import prepare_registration_cloud

_HERE = RigidTransform.identity("t", "s")
_CONFIG = RefineConfig(distance_m=0.3)


def _room(name, seed, roughness_m):
    """Three walls of 6 m; `roughness_m` is how far points lie off the wall across x, y and z."""
    rng = np.random.default_rng(seed)
    walls = []
    for axis, rough_m in enumerate(roughness_m):
        points = rng.uniform(0.0, 6.0, (4000, 3))
        points[:, axis] = rng.normal(0.0, rough_m, 4000)
        walls.append(points)
    return prepare_registration_cloud(name, np.concatenate(walls), FineConfig(), 1)


def _sigma_m(roughness_m):
    information = pose_information(_room("t", 0, roughness_m), _room("s", 1, roughness_m), _HERE, _CONFIG, 1)
    return np.sqrt(np.diag(np.linalg.inv(information)))[3:]


def test_a_direction_that_only_rough_surfaces_hold_is_known_less_well():
    smooth, rough = _sigma_m([0.01, 0.01, 0.01]), _sigma_m([0.08, 0.01, 0.01])
    assert rough[0] > 2.0 * smooth[0]
    assert rough[0] > 1.5 * rough[1:].max()


@pytest.mark.parametrize("noise_m", [0.0, 1e-6, 1e-3, 3e-3])
def test_a_direction_that_nothing_holds_has_no_information(noise_m):
    rng = np.random.default_rng(0)
    target, source = (
        prepare_registration_cloud(
            name, np.column_stack([rng.uniform(-5.0, 5.0, (4000, 2)), rng.normal(0.0, noise_m, 4000)]), FineConfig(), 1
        )
        for name in "ts"
    )
    sigma_m = np.sqrt(np.diag(np.linalg.inv(pose_information(target, source, _HERE, _CONFIG, 1))))[3:]
    assert np.all(sigma_m[:2] > 0.1)
    assert sigma_m[2] < 0.002


def test_normals_that_are_mostly_noise_hold_nothing():
    """Rings of a sparse sensor on flat ground: each ring alone tells the slope across it from noise only."""
    rng = np.random.default_rng(0)
    azimuth = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)

    def rings(name, first_m):
        radii_m = first_m * 1.25 ** np.arange(10.0)
        ground = np.concatenate([np.column_stack([radius_m * across, np.zeros(720)]) for radius_m in radii_m])
        return prepare_registration_cloud(name, ground + rng.normal(0.0, 0.02, ground.shape), FineConfig(), 1)

    target, source = rings("t", 3.0), rings("s", 3.1)
    information = pose_information(target, source, _HERE, _CONFIG, 1)
    sideways_m, height_m = np.split(np.sqrt(np.diag(np.linalg.inv(information)))[3:], [2])
    assert height_m < 0.005
    assert np.all(sideways_m > 0.05)
    _, nearest = target.tree.query(source.points_m)
    believed = replace(source, normals=target.normals[nearest])
    information = pose_information(target, believed, _HERE, _CONFIG, 1)
    assert np.all(np.sqrt(np.diag(np.linalg.inv(information)))[3:5] < 0.03)


def test_too_few_matches_tell_nothing():
    near, far = _room("t", 0, [0.01] * 3), _room("s", 1, [0.01] * 3)
    away = RigidTransform.from_xyz_rpy("t", "s", [100.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert pose_information(near, far, away, _CONFIG, 1) is None
