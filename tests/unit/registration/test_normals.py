# SPDX-License-Identifier: Apache-2.0
import numpy as np

from multilica.registration.neighbours import PointTree
from multilica.registration.normals import Surface

_RNG = np.random.default_rng(0)


def _made(points_m, neighbours=20):
    surface = Surface(PointTree(points_m), neighbours)
    return surface.at(np.arange(len(points_m)))


def test_a_plane_is_flat_and_has_its_normal():
    normal = np.array([0.6, 0.0, 0.8])
    across = np.linalg.qr(np.column_stack([normal, np.eye(3)[:, :2]]))[0][:, 1:]
    normals, flatness = _made(_RNG.uniform(-1.0, 1.0, (500, 2)) @ across.T)
    assert np.allclose(np.abs(normals @ normal), 1.0, atol=1e-6)
    assert np.all(flatness > 0.99)


def test_a_line_and_a_bush_are_not_flat():
    along = np.column_stack([np.linspace(0.0, 5.0, 400), *_RNG.normal(0.0, 0.01, (2, 400))])
    _, line = _made(along)
    _, bush = _made(_RNG.uniform(0.0, 1.0, (4000, 3)))
    assert np.median(line) < 0.4
    assert np.median(bush) < 0.4


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
    normals, flatness = _made(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert np.allclose(np.abs(normals[:, 2]), 1.0)
    assert np.allclose(flatness, 1.0)
