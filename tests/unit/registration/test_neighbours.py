# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.registration.neighbours import PointTree, principal_directions

_RNG = np.random.default_rng(0)
_POINTS_M = _RNG.uniform(-5.0, 5.0, (900, 3))
_ELSEWHERE_M = _RNG.uniform(-9.0, 9.0, (70, 3))


@pytest.mark.parametrize("threads", [1, 2])
def test_neighbours_are_those_that_scipy_finds(threads):
    tree, known = PointTree(_POINTS_M, threads), cKDTree(_POINTS_M)
    nearest_m, nearest = tree.nearest(_ELSEWHERE_M, threads)
    expected_m, expected = known.query(_ELSEWHERE_M)
    assert np.array_equal(nearest, expected)
    assert np.allclose(nearest_m, expected_m, rtol=1e-12)
    assert np.array_equal(tree.neighbours(_ELSEWHERE_M, 7, threads), known.query(_ELSEWHERE_M, k=7)[1])


def test_there_are_no_more_neighbours_than_points():
    index = PointTree(_POINTS_M[:4]).neighbours(_ELSEWHERE_M, 20)
    assert np.array_equal(np.sort(index, axis=1), np.tile(np.arange(4), (70, 1)))


def test_without_points_to_look_for_nothing_is_found():
    distance_m, index = PointTree(_POINTS_M).nearest(np.zeros((0, 3)))
    assert distance_m.shape == index.shape == (0,)


def test_principal_directions_are_those_of_the_covariance():
    neighbours = PointTree(_POINTS_M).neighbours(_ELSEWHERE_M, 12)
    variances, directions = principal_directions(_POINTS_M, neighbours)
    for index, values, axes in zip(neighbours, variances, directions, strict=True):
        scatter = 11.0 * np.cov(_POINTS_M[index].T)
        assert np.allclose(axes @ np.diag(values) @ axes.T, scatter)
        assert np.all(np.diff(values) >= 0.0)
        assert np.allclose(axes.T @ axes, np.eye(3))
