# SPDX-License-Identifier: Apache-2.0
import numpy as np

from multilica.registration.own_body import find_own_body


def _drawn(rng, low, high, count):
    return rng.uniform(low, high, size=(count, 3))


def _stops(rng, *, body, moved=True):
    """A LiDAR 2 m above the ground at three stops, with a bonnet before it and walls that differ."""
    bonnet = _drawn(rng, (1.2, -0.8, -1.1), (2.4, 0.8, -1.05), 400)
    found = []
    for stop in range(3):
        place = 1.7 * stop if moved else 0.0
        ground = _drawn(rng, (-9.0, -9.0, -2.02), (9.0, 9.0, -1.98), 4000)
        wall = _drawn(rng, (3.0 + place, -6.0, -2.0), (3.03 + place, 6.0, 1.0), 3000)
        noise = rng.normal(scale=0.01, size=bonnet.shape)
        found.append(np.concatenate([ground, wall, *([bonnet + noise] if body else [])]))
    return found, bonnet


def test_the_bonnet_is_found_and_nothing_else():
    stops, bonnet = _stops(np.random.default_rng(0), body=True)
    cells = find_own_body(stops, [np.eye(3)])
    assert np.mean(cells.contain(bonnet)) > 0.95
    assert np.mean(cells.contain(stops[1][:7000])) < 0.01


def test_nothing_is_found_without_a_body():
    stops, _ = _stops(np.random.default_rng(1), body=False)
    assert not len(find_own_body(stops, [np.eye(3)]).keys)
    assert not len(find_own_body(stops[:1], [np.eye(3)]).keys)


def test_the_ground_is_no_body_where_a_ceiling_may_be_the_ground():
    rng = np.random.default_rng(3)
    stops, _ = _stops(rng, body=False)
    around = [_drawn(rng, (-9.0, -9.0, -1.5), (9.0, 9.0, 2.5), 6000) for _ in stops]
    stops = [
        np.concatenate([*each, _drawn(rng, (-9.0, -9.0, 2.98), (9.0, 9.0, 3.02), 4000)])
        for each in zip(stops, around, strict=True)
    ]
    upside_down = np.diag([1.0, -1.0, -1.0])
    ground = stops[0][:4000]
    assert find_own_body(stops, [upside_down]).contain(ground).mean() > 0.3
    assert find_own_body(stops, [upside_down, np.eye(3)]).contain(ground).mean() < 0.05


def test_a_vehicle_that_did_not_move_keeps_its_surroundings():
    stops, _ = _stops(np.random.default_rng(2), body=False, moved=False)
    assert not len(find_own_body([stops[0]] * 3, [np.eye(3)]).keys)
