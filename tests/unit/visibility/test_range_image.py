# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.results import BeamLabel
from multilica.visibility.range_image import build_range_image, label_points

_WALL_X_M = 10.0


def _spinning(channels, columns):
    elevation = np.deg2rad(np.linspace(-15, 15, channels))
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    return np.stack(np.meshgrid(elevation, azimuth, indexing="ij"), axis=-1).reshape(-1, 2)


def _rosette(count):
    turn = np.linspace(0, 400 * np.pi, count)
    radius = np.deg2rad(35) * np.abs(np.sin(3.7 * turn / 7))
    return np.stack([radius * np.sin(turn), radius * np.cos(turn)], axis=1)


_PATTERNS = {"128 rings": _spinning(128, 1024), "16 rings": _spinning(16, 1800), "rosette": _rosette(40_000)}


def _wall_returns(angles, rotation):
    """A wall at x = 10 m, seen by beams of the given elevation and azimuth."""
    elevation, azimuth = angles.T
    beams = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    beams = beams[beams[:, 0] > 0.3]
    return (beams * (_WALL_X_M / beams[:, :1])) @ rotation.T


def _probes(x_m):
    y, z = np.meshgrid(np.linspace(-3, 3, 20), np.linspace(-1.5, 1.5, 10))
    return np.stack([np.full(y.size, x_m), y.ravel(), z.ravel()], axis=1)


@pytest.mark.parametrize("turn", [0, 1, 2])
@pytest.mark.parametrize("pattern", _PATTERNS)
def test_points_on_before_and_behind_a_wall(pattern, turn):
    rotation = Rotation.random(random_state=turn).as_matrix() if turn else np.eye(3)
    image = build_range_image(_wall_returns(_PATTERNS[pattern], rotation))
    for x_m, expected in ((9.95, BeamLabel.AGREE), (7.0, BeamLabel.VIOLATE), (12.0, BeamLabel.OCCLUDED)):
        labels = label_points(image, _probes(x_m) @ rotation.T, 0.15, 0.005)
        assert np.mean(labels == expected) > 0.97, (x_m, np.bincount(labels, minlength=4))


def test_outside_the_field_of_view_nothing_is_known():
    image = build_range_image(_wall_returns(_PATTERNS["128 rings"], np.eye(3)))
    behind = _probes(-5.0)
    above = np.array([[1.0, 0.0, 8.0], [0.0, 1.0, 8.0]])
    assert np.all(label_points(image, np.concatenate([behind, above]), 0.15, 0.005) == BeamLabel.UNSEEN)


def test_a_gap_in_the_beams_proves_nothing():
    angles = _PATTERNS["128 rings"]
    image = build_range_image(_wall_returns(angles[np.abs(angles[:, 1]) > np.deg2rad(12)], np.eye(3)))
    assert np.all(label_points(image, np.array([[5.0, 0.0, 0.0], [9.9, 0.1, 0.1]]), 0.15, 0.005) == BeamLabel.UNSEEN)


def test_only_space_before_an_edge_is_proven_empty():
    returns = _wall_returns(_PATTERNS["128 rings"], np.eye(3))
    right = returns[:, 1] < 0
    returns[right] *= 0.5
    image = build_range_image(returns)
    assert label_points(image, np.array([[3.0, 0.0, 0.0]]), 0.15, 0.005)[0] == BeamLabel.VIOLATE
    assert label_points(image, np.array([[7.5, 0.01, 0.0]]), 0.15, 0.005)[0] != BeamLabel.VIOLATE


def test_too_few_beams_make_no_image():
    assert build_range_image(np.eye(3)) is None
    assert build_range_image(np.empty((0, 3))) is None
