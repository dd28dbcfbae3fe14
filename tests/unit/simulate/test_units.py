# SPDX-License-Identifier: Apache-2.0
"""Units of a model of LiDAR: each has errors of its own, and all see surfaces as light does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica.simulate import RIGS, plan_fleet, simulate_snapshot, simulation
from multilica.simulate.rigs import as_built
from multilica.simulate.scenes import SCENES
from multilica.simulate.sensors import (
    Accuracy,
    Hits,
    RasterPattern,
    RosettePattern,
    SensorModel,
    SpinningPattern,
    measure,
    returned_points,
)
from multilica.simulate.shapes.mesh import merged
from multilica.simulate.units import draw_reflectivities, draw_unit
from multilica.simulate.world import Exposure, World, random_stream
from multilica.snapshot import Scan

_SPINNING = SensorModel(SpinningPattern(16, 1800, (-15.0, 15.0)), max_range_m=200.0)
_RASTER = SensorModel(RasterPattern(100, 200, 20.0, 10.0), max_range_m=200.0, range_noise_m=0.0, dropout=0.0)
_EXACT = Accuracy(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _rng(seed=0):
    return np.random.default_rng(seed)


def _all_around(range_m, reflectivity=0.3, cosine=1.0):
    """Surfaces at one range, met at one angle."""
    return lambda beams: Hits(*(np.full(len(beams), value) for value in (range_m, cosine, reflectivity)))


def _two_surfaces(left_m, right_m, *, reflectivity=0.3):
    """Of another range to the left and to the right, head-on."""

    def cast(beams):
        ranges_m = np.where(beams[:, 1] > 0.0, left_m, right_m)
        return Hits(ranges_m, np.ones(len(beams)), np.full(len(beams), reflectivity))

    return cast


def _measured(unit, cast, seed=1):
    directions = unit.sensor.pattern.directions(0, _rng(seed))
    return directions, *unit.measure(directions, cast, _rng(seed + 1), _rng(seed + 2))


def _exact_unit(sensor):
    return draw_unit(replace(sensor, accuracy=_EXACT), _rng())


def _of_ring(unit, values):
    rings = unit.sensor.pattern.rings
    return np.array([np.nanmean(values[rings == ring]) for ring in range(rings.max() + 1)])


@pytest.mark.parametrize(
    ("pattern", "count"),
    [(_SPINNING.pattern, 16), (_RASTER.pattern, 100), (RosettePattern(6000, 70.0, 25.0), 6)],
    ids=["spinning", "raster", "rosette"],
)
def test_rings_are_beams_of_one_laser(pattern, count):
    directions, rings = pattern.directions(0, _rng()), pattern.rings
    assert len(rings) == len(directions)
    assert sorted(set(rings.tolist())) == list(range(count))
    if not isinstance(pattern, RosettePattern):
        spreads = [np.ptp(directions[rings == ring, 2]) for ring in range(count)]
        assert max(spreads) < 1e-9


def test_a_unit_without_errors_measures_as_an_ideal_lidar():
    sensor = replace(_SPINNING, range_step_m=1e-9, beam_deg=0.0, dark_range_m=1e6)
    unit, cast = _exact_unit(sensor), _two_surfaces(10.0, 12.0)
    directions, ranges_m, _ = _measured(unit, cast)
    ideal_m = measure(sensor, cast(directions), _rng(2))
    assert np.isnan(ideal_m).sum() > 100
    np.testing.assert_allclose(ranges_m, ideal_m, atol=1e-8)


def test_the_mean_error_of_a_ring_is_its_bias():
    unit = draw_unit(_SPINNING, _rng())
    _, ranges_m, _ = _measured(unit, _all_around(10.0))
    expected_m = unit.range_bias_m + 10.0 * unit.range_scale
    assert np.std(expected_m) > 0.003
    np.testing.assert_allclose(_of_ring(unit, ranges_m) - 10.0, expected_m, atol=5.0 * 0.018 / np.sqrt(1800))


@pytest.mark.parametrize(
    ("accuracy", "surface", "expected_m"),
    [
        ("range_scale", {"range_m": 50.0}, 0.05),
        ("glancing_m", {"range_m": 10.0, "cosine": 0.25}, 0.75e-3),
        ("reflectivity_m", {"range_m": 10.0, "reflectivity": 0.7}, 0.4e-3),
        ("reflectivity_m", {"range_m": 10.0, "reflectivity": 20.0}, 0.7e-3),
        ("reflectivity_m", {"range_m": 10.0, "reflectivity": 0.1}, -0.2e-3),
    ],
)
def test_the_error_follows_the_surface(accuracy, surface, expected_m):
    sensor = replace(_RASTER, range_step_m=1e-6)
    unit = replace(_exact_unit(sensor), **{accuracy: 1e-3})
    _, ranges_m, _ = _measured(unit, _all_around(**surface))
    assert np.nanmean(ranges_m) - surface["range_m"] == pytest.approx(expected_m, abs=2e-6)


def test_directions_are_off_by_ring():
    """The beams go elsewhere than the points that the LiDAR reports."""
    unit = draw_unit(replace(_SPINNING, beam_deg=0.0), _rng())
    cast_along = []

    def cast(beams):
        cast_along.append(beams)
        return _all_around(10.0)(beams)

    directions, *_ = _measured(unit, cast)
    beams, rings = cast_along[0], unit.sensor.pattern.rings
    raised_rad = np.arcsin(beams[:, 2]) - np.arcsin(directions[:, 2])
    np.testing.assert_allclose(raised_rad, unit.elevation_rad[rings], atol=1e-9)
    turned_rad = np.angle((beams[:, 0] + 1j * beams[:, 1]) * np.conj(directions[:, 0] + 1j * directions[:, 1]))
    np.testing.assert_allclose(turned_rad, unit.azimuth_rad[rings], atol=1e-9)


def test_errors_have_the_stated_deviations():
    units = [draw_unit(_SPINNING, _rng(seed)) for seed in range(400)]
    accuracy = _SPINNING.accuracy
    of_ring = np.array([unit.range_bias_m for unit in units])
    assert of_ring.mean(axis=1).std() == pytest.approx(np.hypot(accuracy.range_m, accuracy.ring_range_m / 4), rel=0.15)
    assert of_ring.std(axis=1).mean() == pytest.approx(accuracy.ring_range_m, rel=0.1)
    for name, expected in (
        ("range_scale", accuracy.range_scale),
        ("glancing_m", accuracy.glancing_m),
        ("reflectivity_m", accuracy.reflectivity_m),
        ("elevation_rad", np.deg2rad(accuracy.ring_elevation_deg)),
        ("azimuth_rad", np.deg2rad(accuracy.ring_azimuth_deg)),
    ):
        values = np.array([getattr(unit, name) for unit in units])
        assert values.std() == pytest.approx(expected, rel=0.15)
        assert abs(values.mean()) < 0.2 * expected


def test_azimuth_errors_do_not_rotate_the_frame():
    unit = draw_unit(_SPINNING, _rng())
    assert unit.azimuth_rad.mean() == pytest.approx(0.0, abs=1e-12)
    assert abs(unit.elevation_rad.mean()) > 1e-6
    assert np.std(unit.azimuth_rad) > 0.5 * np.deg2rad(_SPINNING.accuracy.ring_azimuth_deg)


def test_ranges_are_in_steps():
    unit = _exact_unit(replace(_SPINNING, range_step_m=0.004))
    _, ranges_m, _ = _measured(unit, _all_around(10.0))
    steps = ranges_m[np.isfinite(ranges_m)] / 0.004
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert len(np.unique(np.round(steps))) > 10


@pytest.mark.parametrize(
    ("reflectivity", "range_m", "cosine", "share"),
    [
        (0.1, 80.0, 1.0, 0.9),
        (0.05, 80.0, 1.0, 0.684),
        (0.1, 160.0, 1.0, 0.438),
        (0.1, 80.0, 0.5, 0.684),
        (0.3, 20.0, 1.0, 1.0),
    ],
)
def test_far_dark_and_glancing_surfaces_return_less(reflectivity, range_m, cosine, share):
    sensor = replace(_RASTER, grazing_cosine=1e-3)
    _, ranges_m, intensities = _measured(_exact_unit(sensor), _all_around(range_m, reflectivity, cosine))
    assert np.isfinite(ranges_m).mean() == pytest.approx(share, abs=0.02)
    assert np.nanmean(intensities) == pytest.approx(100.0 * reflectivity * cosine, abs=0.51)


def test_what_returns_nothing_stays_without_a_range():
    _, ranges_m, _ = _measured(draw_unit(_RASTER, _rng()), _two_surfaces(np.inf, 30.0))
    assert 0.45 < np.isnan(ranges_m).mean() < 0.55


@pytest.mark.parametrize("apart_m", [0.5, -0.5])
def test_between_near_surfaces_points_mix(apart_m):
    unit = _exact_unit(replace(_RASTER, range_step_m=1e-6))
    directions, ranges_m, _ = _measured(unit, _two_surfaces(10.0, 10.0 + apart_m))
    low_m, high_m = sorted((10.0, 10.0 + apart_m))
    mixed = (ranges_m > low_m + 1e-3) & (ranges_m < high_m - 1e-3)
    assert 20 < mixed.sum() < 0.02 * len(ranges_m)
    assert np.abs(np.rad2deg(directions[mixed, 1])).max() < 0.25
    assert low_m - 1e-5 < np.nanmin(ranges_m) < np.nanmax(ranges_m) < high_m + 1e-5


def test_between_far_surfaces_points_are_of_either():
    unit = _exact_unit(replace(_RASTER, range_step_m=1e-6))
    directions, ranges_m, _ = _measured(unit, _two_surfaces(10.0, 12.0))
    found = ranges_m[np.isfinite(ranges_m)]
    assert np.all((np.abs(found - 10.0) < 1e-5) | (np.abs(found - 12.0) < 1e-5))
    elsewhere = np.isfinite(ranges_m) & ((np.abs(ranges_m - 10.0) < 1e-5) != (directions[:, 1] > 0.0))
    assert 5 < elsewhere.sum() < 0.01 * len(found)


def _sign(beams):
    """A retroreflector of one degree before a wall."""
    off_deg = np.rad2deg(np.hypot(beams[:, 1], beams[:, 2]))
    struck = off_deg < 1.0
    return Hits(np.where(struck, 20.0, 30.0), np.ones(len(beams)), np.where(struck, 20.0, 0.3))


def test_a_retroreflector_blooms():
    unit = _exact_unit(replace(_RASTER, beam_deg=0.0, range_step_m=1e-6))
    directions, ranges_m, intensities = _measured(unit, _sign)
    off_deg = np.rad2deg(np.hypot(directions[:, 1], directions[:, 2]))
    near = np.abs(ranges_m - 20.0) < 1e-5
    assert np.all(near[off_deg < 0.99])
    shares = [near[(off_deg > low) & (off_deg < low + 0.15)].mean() for low in (1.01, 1.2, 1.4)]
    assert 0.3 < shares[0] < 0.6
    assert shares[0] > shares[1] > shares[2] > 0.0
    assert not np.any(near[off_deg > 1.8])
    assert np.all(intensities[off_deg < 0.99] == 255.0)
    assert np.all(intensities[near & (off_deg > 1.01)] < 100.0)


@pytest.mark.parametrize("cast", [_sign, _two_surfaces(5.0, 90.0), _all_around(40.0, 0.03, 0.01)])
def test_intensities_are_whole_numbers_of_a_byte(cast):
    _, ranges_m, intensities = _measured(draw_unit(_SPINNING, _rng()), cast)
    assert len(intensities) == len(ranges_m)
    assert np.array_equal(intensities, np.round(intensities))
    assert 0.0 <= intensities.min() <= intensities.max() <= 255.0


def test_reflectivities_of_bodies():
    """A fifth is dark, and a tenth of the small ones reflects."""
    lengths_m = np.repeat([1.0, 30.0], 5000)
    drawn = draw_reflectivities(lengths_m, _rng())
    reflects = drawn > 1.0
    assert reflects[:5000].mean() == pytest.approx(0.1, abs=0.02)
    assert not np.any(reflects[5000:])
    matt = drawn[~reflects]
    assert (matt < 0.1).mean() == pytest.approx(0.2, abs=0.02)
    assert 0.03 <= matt.min() < matt.max() <= 0.7


@pytest.fixture
def units_of(monkeypatch):
    """Record the units that a simulation gives to the LiDARs, and take no scans."""

    class _Recorded(World):
        def scan(self, mount, unit, _taken):
            found[mount.name] = unit
            return Scan(np.zeros((1, 3), dtype=np.float32))

    found = {}
    monkeypatch.setattr(simulation, "World", _Recorded)

    def simulate(*arguments, **options):
        found.clear()
        simulate_snapshot(*arguments, **options)
        return dict(found)

    return simulate


def _errors(unit):
    return np.concatenate([unit.range_bias_m, unit.elevation_rad, unit.azimuth_rad, [unit.range_scale]])


def test_a_vehicle_has_the_same_units_in_all_scenes(units_of):
    first = units_of("edgar", "street", 1, build_seed=3)
    second = units_of("edgar", "garage", 2, build_seed=3, frames=7)
    own = units_of("edgar", "garage", 3)
    other = units_of("edgar", "street", 1, build_seed=4)
    for name, unit in first.items():
        assert np.array_equal(_errors(unit), _errors(second[name]))
        assert np.array_equal(_errors(unit), _errors(own[name]))
        assert not np.any(_errors(unit) == _errors(other[name]))
    assert not np.any(_errors(first["left"]) == _errors(first["right"]))


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_vehicle_has_the_same_units_in_all_its_logs(units_of):
    """Whatever the place, the time, and a LiDAR that has moved or died."""
    plan = plan_fleet(3, 18, 2)
    found = {}
    for log in plan.logs:
        units = units_of(plan.rig, log.scene, log.seed, build_seed=plan.build_seeds[log.vehicle], moved=log.moved)
        found.setdefault(log.vehicle, []).append(np.concatenate([_errors(unit) for unit in units.values()]))
    assert len(found) == 3
    for errors in found.values():
        assert len(errors) >= 5
        assert all(np.array_equal(each, errors[0]) for each in errors)
    assert len({errors[0].tobytes() for errors in found.values()}) == 3


def test_ideal_lidars_are_no_units(units_of):
    assert set(units_of("edgar", "street", 1, sensors="ideal").values()) == {None}


def _scans_of(rig, mount, unit):
    scene = SCENES["garage"](random_stream("garage", 2))
    world = World(RIGS[rig], scene, ("garage", 2), as_built(RIGS[rig], random_stream(rig, "mounting", 2)))
    return world, world.scan(mount, unit, _exposure(world, mount))


def _exposure(world, mount):
    return Exposure(0, 0, world.T_base_lidar[mount.name], (world.scene.T_world_base,), merged([]))


def test_an_ideal_lidar_reports_what_it_measures():
    """Bit for bit the noise of its own stream, and nothing but points."""
    mount = RIGS["blind"].mounts[0]
    world, scan = _scans_of("blind", mount, None)
    rng = random_stream(world.label, mount.name, 0)
    directions = mount.sensor.pattern.directions(0, rng)
    expected = returned_points(
        directions, measure(mount.sensor, world._caster(_exposure(world, mount))(directions), rng)
    )
    assert len(expected) > 1000
    np.testing.assert_array_equal(scan.points_m, expected)
    assert (scan.intensity, scan.rings, scan.times_ns) == (None, None, None)


def test_a_real_lidar_sees_its_own_vehicle():
    """Hundreds of returns lie on the body, above the ground."""
    mount = RIGS["sides"].mounts[1]
    world, scan = _scans_of("sides", mount, draw_unit(mount.sensor, _rng()))
    points_m = world.T_base_lidar[mount.name].apply(scan.points_m.astype(np.float64))
    half_x_m, half_y_m = RIGS["sides"].half_size_m
    on_body = (np.abs(points_m[:, 0]) < half_x_m) & (np.abs(points_m[:, 1]) < half_y_m) & (points_m[:, 2] > 0.25)
    assert 300 < on_body.sum() < 0.5 * len(points_m)


def test_a_real_lidar_reports_an_intensity_per_point():
    mount = RIGS["blind"].mounts[0]
    _, scan = _scans_of("blind", mount, draw_unit(mount.sensor, _rng()))
    assert scan.intensity.shape == (len(scan.points_m),)
    assert len(np.unique(scan.intensity)) > 20
    assert 0.0 <= scan.intensity.min() <= scan.intensity.max() <= 255.0


def test_a_real_lidar_tells_ring_and_time_of_each_point():
    """Points of a ring lie at the elevation of their laser; the azimuth of a spinning LiDAR rises with time."""
    mount = RIGS["sides"].mounts[0]
    _, scan = _scans_of("sides", mount, _exact_unit(mount.sensor))
    assert len(scan.rings) == len(scan.times_ns) == len(scan.points_m)
    elevation_deg = np.rad2deg(np.arcsin(scan.points_m[:, 2] / np.linalg.norm(scan.points_m, axis=1)))
    pattern = mount.sensor.pattern
    expected_deg = np.linspace(*pattern.elevation_deg, pattern.channels)[scan.rings]
    np.testing.assert_allclose(elevation_deg, expected_deg, atol=1e-3)
    assert np.all(np.diff(scan.times_ns.astype(np.int64)) >= 0)
    assert scan.times_ns[-1] < 100_000_000
    azimuth = np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]) / (2.0 * np.pi) % 1.0
    np.testing.assert_allclose(scan.times_ns / 1e8, azimuth, atol=1.0 / pattern.columns + 1e-6)


def test_a_real_lidar_sees_the_same_scene():
    """The errors of a unit are millimetres, and few beams are lost."""
    mount = RIGS["edgar"].mounts[0]
    (_, ideal), (_, real) = (_scans_of("edgar", mount, unit) for unit in (None, draw_unit(mount.sensor, _rng())))
    medians = [np.median(np.linalg.norm(scan.points_m, axis=1)) for scan in (ideal, real)]
    assert medians[1] == pytest.approx(medians[0], rel=0.02)
    assert 0.7 < len(real.points_m) / len(ideal.points_m) < 1.0
