# SPDX-License-Identifier: Apache-2.0
"""Derivatives by differences, and poses to take them at."""

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform

TURNS_RAD = (0.1, 1.0, 2.0, 3.0)
_STEP = 1e-5


def derivative(function, count=6):
    """(N, count) of a function (N,) of a motion (6,), or of more, at rest."""
    columns = [(function(step) - function(-step)) / (2.0 * _STEP) for step in _STEP * np.eye(count)]
    return np.stack(columns, axis=-1)


def assert_alike(found, expected, tolerance=1e-6):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


def drawn_pose(target, source, turn_rad, rng, lever_m=4.0):
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(turn_rad * axis / np.linalg.norm(axis)).as_matrix()
    return RigidTransform.from_rotation_translation(target, source, turn, rng.normal(scale=lever_m, size=3))
