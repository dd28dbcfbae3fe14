# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from multilica.registration.neighbours import MovedPoints, PointTree, Surface, spread_and_normals

_RNG = np.random.default_rng(0)
_POINTS_M = _RNG.uniform(-5.0, 5.0, (900, 3))
_ELSEWHERE_M = _RNG.uniform(-9.0, 9.0, (70, 3))


def test_neighbours_are_those_that_scipy_finds():
    tree, known = PointTree(_POINTS_M), cKDTree(_POINTS_M)
    nearest_m, nearest = tree.nearest(_ELSEWHERE_M)
    expected_m, expected = known.query(_ELSEWHERE_M)
    assert np.array_equal(nearest, expected)
    assert np.allclose(nearest_m, expected_m, rtol=1e-12)
    assert np.array_equal(tree.neighbours(_ELSEWHERE_M, 7), known.query(_ELSEWHERE_M, k=7)[1])


def test_there_are_no_more_neighbours_than_points():
    index = PointTree(_POINTS_M[:4]).neighbours(_ELSEWHERE_M, 20)
    assert np.array_equal(np.sort(index, axis=1), np.tile(np.arange(4), (70, 1)))


def test_without_points_to_look_for_nothing_is_found():
    distance_m, index = PointTree(_POINTS_M).nearest(np.zeros((0, 3)))
    assert distance_m.shape == index.shape == (0,)


@pytest.mark.parametrize("flatness", [1.0, 1e-2, 1e-6, 0.0])
def test_spread_and_normal_are_those_of_the_covariance(flatness):
    turn = Rotation.from_rotvec([0.3, -1.2, 0.7])
    points_m = turn.apply(_POINTS_M * [1.0, 0.2, flatness])
    neighbours = PointTree(points_m).neighbours(_ELSEWHERE_M, 12)
    variances, normals = spread_and_normals(points_m, neighbours)
    for index, values, normal in zip(neighbours, variances, normals, strict=True):
        expected, directions = np.linalg.eigh(11.0 * np.cov(points_m[index].T))
        assert np.allclose(values, expected, atol=1e-12 * expected[-1])
        assert abs(normal @ directions[:, 0]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("size", [1, 2, 7])
def test_normals_do_not_depend_on_the_points_of_the_same_call(size):
    points_m = np.random.default_rng(0).normal(size=(2000, 3)) * [5.0, 3.0, 0.1]
    neighbours = PointTree(points_m).neighbours(points_m, 20)
    variances, normals = spread_and_normals(points_m, neighbours)
    for start in range(0, 700, size):
        some = slice(start, start + size)
        for found, whole in zip(spread_and_normals(points_m, neighbours[some]), (variances, normals), strict=True):
            np.testing.assert_array_equal(found, whole[some])


def test_points_in_one_place_have_no_spread_and_no_normal():
    variances, normals = spread_and_normals(np.ones((5, 3)), np.zeros((2, 4), dtype=np.int64))
    assert np.allclose(variances, 0.0, atol=1e-90)
    assert np.allclose(normals, 0.0, atol=1e-90)


@pytest.mark.parametrize("motion_m", [0.0, 1e-3, 0.1, 5.0])
def test_moved_points_have_the_neighbours_of_a_new_search(motion_m):
    tree, moved = PointTree(_POINTS_M), MovedPoints.of(PointTree(_POINTS_M), _ELSEWHERE_M)
    there_m = _ELSEWHERE_M + motion_m * _RNG.normal(size=_ELSEWHERE_M.shape)
    for found, expected in zip(moved.nearest(there_m), tree.nearest(there_m), strict=True):
        assert np.allclose(found, expected)
    some = slice(1, None, 3)
    for found, expected in zip(moved.subset(some).nearest(there_m[some]), tree.nearest(there_m[some]), strict=True):
        assert np.allclose(found, expected)


@pytest.mark.parametrize("reach_m", [0.0, 0.3, 2.0, 30.0])
def test_a_bounded_search_finds_what_an_unbounded_one_does(reach_m):
    tree, points_m = PointTree(_POINTS_M), 3.0 * _ELSEWHERE_M
    known_m, _ = tree.nearest(points_m)
    near, distance_m, _ = tree.nearest_within(points_m, reach_m)
    assert np.array_equal(near, np.flatnonzero(known_m <= reach_m))
    assert np.array_equal(distance_m, known_m[near])


def test_a_bounded_search_among_points_of_one_place():
    near, distance_m, _ = PointTree(np.ones((3, 3))).nearest_within(np.array([[1.0, 1.0, 1.1], [9.0, 1.0, 1.0]]), 0.2)
    assert near.tolist() == [0]
    assert distance_m == pytest.approx([0.1])


def _surface_at(points_m, neighbours=20):
    surface = Surface(PointTree(points_m), neighbours)
    return surface.at(np.arange(len(points_m)))


def test_a_plane_is_flat_and_has_its_normal():
    normal = np.array([0.6, 0.0, 0.8])
    across = np.linalg.qr(np.column_stack([normal, np.eye(3)[:, :2]]))[0][:, 1:]
    normals, flatness = _surface_at(_RNG.uniform(-1.0, 1.0, (500, 2)) @ across.T)
    assert np.allclose(np.abs(normals @ normal), 1.0, atol=1e-6)
    assert np.all(flatness > 0.99)


def test_a_line_and_a_bush_are_not_flat():
    along = np.column_stack([np.linspace(0.0, 5.0, 400), *_RNG.normal(0.0, 0.01, (2, 400))])
    _, line = _surface_at(along)
    _, bush = _surface_at(_RNG.uniform(0.0, 1.0, (4000, 3)))
    assert np.median(line) < 0.4
    assert np.median(bush) < 0.4


def test_a_scan_line_is_not_flat():
    """Ranges are noisy and elevations are not, so that its points seem to span a plane along the beams."""
    across = np.linspace(-3.0, 3.0, 400)
    points_m = np.column_stack([8.0 + _RNG.normal(0.0, 0.02, 400), across, _RNG.normal(0.0, 1e-4, 400)])
    surface = Surface(PointTree(points_m), 20)
    assert np.all(surface.at(np.arange(400))[1] == 0.0)
    assert np.all(surface.on_line(np.arange(400)))


def test_two_scan_lines_span_a_surface():
    across = np.linspace(-3.0, 3.0, 40)
    lines = [np.column_stack([8.0 + _RNG.normal(0.0, 0.01, 40), across, np.full(40, z_m)]) for z_m in (0.0, 0.3)]
    surface = Surface(PointTree(np.concatenate(lines)), 20)
    assert not np.any(surface.on_line(np.arange(80)))


def test_what_is_asked_for_twice_or_in_another_order_is_the_same():
    points_m = _RNG.uniform(0.0, 1.0, (300, 3))
    surface = Surface(PointTree(points_m), 12)
    some = np.array([5, 250, 5, 17])
    first = surface.at(some)
    everything = surface.at(np.arange(300))
    assert np.array_equal(first[0], everything[0][some])
    assert np.array_equal(first[1], everything[1][some])
    assert np.array_equal(surface.at(some)[1], first[1])


def test_fewer_points_than_neighbours_are_enough():
    normals, flatness = _surface_at(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert np.allclose(np.abs(normals[:, 2]), 1.0)
    assert np.allclose(flatness, 1.0)
