# SPDX-License-Identifier: Apache-2.0
"""Each disturbance does what it says, where it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.errors import UnknownNameError, UsageError
from multilica.simulate import RIGS, simulate_snapshot
from multilica.simulate import simulation as simulation_module
from multilica.simulate.disturbances import blocked_beams, random_walkers, require_known, truck_beside
from multilica.simulate.rigs import as_built
from multilica.simulate.scenes import SCENES
from multilica.simulate.sensors import Surroundings
from multilica.simulate.shapes.mesh import merged
from multilica.simulate.simulation import Sensors
from tests.selection import some_of


def both(rig: str, scene: str, *disturbances: str, frames: int = 1, sensors: Sensors = "real"):
    clean = simulate_snapshot(rig, scene, 6, frames=frames, sensors=sensors)
    disturbed = simulate_snapshot(rig, scene, 6, frames=frames, disturbances=disturbances, sensors=sensors)
    return clean.snapshot, disturbed.snapshot


@pytest.mark.slow
def test_rain_replaces_two_per_cent_by_nearer_returns():
    clean, rainy = both("sides", "street", "rain")
    dry, wet = clean["top"].scans[0].points_m, rainy["top"].scans[0].points_m
    assert len(dry) == len(wet)
    struck = np.any(dry != wet, axis=1)
    assert 0.017 < struck.mean() < 0.023
    dry_m, wet_m = (np.linalg.norm(points[struck], axis=1) for points in (dry, wet))
    assert np.all(wet_m <= dry_m + 1e-3)
    assert 0.4 < np.mean(wet_m / dry_m) < 0.65


def test_a_dead_lidar_does_not_change_the_others():
    clean, sick = both("blind", "garage", "dead:rear", frames=2)
    assert sick["rear"].points_count == 0
    assert len(sick["rear"].scans) == 2
    for name in ("front_left", "front_right"):
        np.testing.assert_array_equal(sick[name].points_m, clean[name].points_m)


def test_dirt_blocks_a_connected_half():
    clean, dirty = both("sides", "garage", "dirty:right", sensors="ideal")
    before, after = clean["right"].points_m, dirty["right"].points_m
    seen = after[np.linalg.norm(after, axis=1) > 1.0]
    assert 0.3 < len(seen) / (np.linalg.norm(before, axis=1) > 1.0).sum() < 0.7
    assert (np.linalg.norm(after, axis=1) <= 1.0).mean() > 0.15
    np.testing.assert_array_equal(dirty["left"].points_m, clean["left"].points_m)


def test_blocked_beams_are_half_of_them_on_one_side():
    directions = RIGS["edgar"].mounts[0].sensor.pattern.directions(0, np.random.default_rng(1))
    axis = np.array([0.2, 0.9, -0.3])
    blocked = blocked_beams(directions, axis)
    assert abs(blocked.mean() - 0.5) < 0.01
    assert (directions[blocked] @ axis).min() >= (directions[~blocked] @ axis).max()


@pytest.mark.slow
@pytest.mark.parametrize("rig", some_of(sorted(RIGS), 2))
def test_a_truck_blocks_about_half_of_a_view(rig):
    rng = np.random.default_rng(3)
    scene = SCENES["parking"](rng)
    poses = as_built(RIGS[rig], rng)
    # None of the truck's few places lies across half of a narrow view straight on.
    least = 0.15 if rig in ("narrow4", "trailer") else 0.3
    for mount in RIGS[rig].mounts:
        truck = Surroundings(truck_beside(scene, RIGS[rig], mount, poses[mount.name], rng))
        directions = mount.sensor.pattern.directions(0, rng)
        hits = truck.cast(scene.T_world_base @ poses[mount.name], directions)
        assert least < np.isfinite(hits.ranges_m).mean() < 0.7, mount.name


@pytest.mark.slow
def test_a_truck_hides_what_is_behind_it():
    clean, beside = both("chain", "parking", "truck", sensors="ideal")
    changed = [name for name in clean.names if clean[name].points_count != beside[name].points_count]
    assert changed


@pytest.mark.slow
@pytest.mark.in_turn
def test_pedestrians_move_between_frames():
    clean, walked = both("sides", "parking", "pedestrians", frames=4, sensors="ideal")
    background = cKDTree(clean["top"].points_m)
    people = []
    for scan in (walked["top"].scans[0], walked["top"].scans[3]):
        near = scan.points_m[np.linalg.norm(scan.points_m, axis=1) < 17.0]
        people.append(near[background.query(near, distance_upper_bound=0.35)[0] > 0.35])
    assert min(len(points) for points in people) > 50
    stride_m = np.median(cKDTree(people[0]).query(people[1])[0])
    assert stride_m > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["edgar", "truck"])
def test_nobody_walks_through_the_vehicle(rig):
    walkers, tried = [], some_of(range(20), 4)
    for seed in tried:
        rng = np.random.default_rng(seed)
        scene = SCENES["parking"](rng)
        walkers += [(scene, each) for each in random_walkers(scene, RIGS[rig], Surroundings(merged(scene.parts)), rng)]
    assert len(walkers) > 2 * len(tried)
    for scene, walker in walkers:
        feet_m = scene.T_world_base.inverse().apply([*walker.xy_m, scene.T_world_base.xyz_m[2]])[:2]
        assert np.hypot(*feet_m) > max(3.4, RIGS[rig].half_size_m[0] + 0.9)


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("rig", "sensors"), some_of([("edgar", "ideal"), ("ring6", "ideal"), ("truck", "ideal"), ("ring6", "real")], 1)
)
def test_masked_returns_are_those_of_the_vehicle(rig, sensors):
    """At its edges, the points of real LiDARs mix vehicle and ground."""
    clean, masked = both(rig, "parking", "ego_masked", sensors=sensors)
    mixed = {"ideal": 0.0, "real": 0.01}[sensors]
    truth = simulate_snapshot(rig, "parking", 6, frames=1).truth
    low_m, high_m = RIGS[rig].body.vertices_m.min(axis=0) - 0.1, RIGS[rig].body.vertices_m.max(axis=0) + 0.1
    left_out = 0
    for name in clean.names:
        kept = {point.tobytes() for point in masked[name].points_m}
        assert len(kept - {point.tobytes() for point in clean[name].points_m}) <= mixed * len(kept)
        gone = np.array([point for point in clean[name].points_m if point.tobytes() not in kept]).reshape(-1, 3)
        in_base = truth.T_target_source[name].apply(gone)
        assert np.sum(np.any((in_base < low_m) | (in_base > high_m), axis=1)) <= mixed * len(gone)
        left_out += len(gone)
    assert left_out > 1000


@pytest.mark.slow
@pytest.mark.in_turn
def test_rain_falls_on_a_vehicle_that_is_masked():
    _, masked = both("sides", "street", "ego_masked")
    _, rainy = both("sides", "street", "ego_masked", "rain")
    before, after = masked["left"].points_m, rainy["left"].points_m
    assert len(before) == len(after)
    assert 0.015 < np.any(before != after, axis=1).mean() < 0.025


def test_a_moving_vehicle_moves_while_it_scans(monkeypatch):
    """At 3 m/s it goes 0.3 m in a frame, so that beams at its end are cast from there."""
    on_way = simulate_snapshot("sides", "street", 1, frames=1, disturbances=("moving",), sensors="ideal").snapshot
    monkeypatch.setattr(simulation_module, "WAY_SHARES", np.zeros(1))
    at_stamp = simulate_snapshot("sides", "street", 1, frames=1, disturbances=("moving",), sensors="ideal").snapshot
    for one, other in zip(on_way.lidars, at_stamp.lidars, strict=True):
        near, _ = cKDTree(other.points_m).query(one.points_m)
        assert 0.1 < np.percentile(near, 95) < 1.0


@pytest.mark.slow
def test_a_moving_vehicle_shifts_each_frame():
    still, moving = both("sides", "street", "moving", frames=3, sensors="ideal")
    for snapshot, low, high in ((still, 0.0, 0.13), (moving, 0.15, 1.0)):
        first, last = (snapshot["top"].scans[index].points_m for index in (0, 2))
        upright = last[(last[:, 2] > -1.0) & (np.linalg.norm(last, axis=1) < 12.0)][::9]
        assert low <= float(np.percentile(cKDTree(first).query(upright)[0], 75)) < high


def test_low_overlap_leaves_a_tenth_of_the_view():
    wide, thin = both("chain", "garage", "low_overlap")
    assert wide.names == thin.names
    simulation = simulate_snapshot("chain", "garage", 6, frames=1, disturbances=("low_overlap",), sensors="ideal")
    shared = []
    for target, source in (("front_left", "left"), ("front_right", "front_left")):
        clouds = [simulation.truth.T_target_source[name].apply(thin[name].points_m) for name in (target, source)]
        shared.append(float((cKDTree(clouds[0]).query(clouds[1][::9])[0] < 0.2).mean()))
    assert all(0.02 < share < 0.2 for share in shared), shared


def test_low_overlap_belongs_to_chain():
    with pytest.raises(UsageError, match="only for rig 'chain'"):
        simulate_snapshot("edgar", "street", 1, disturbances=("low_overlap",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rian", "There is no disturbance 'rian'.*Did you mean 'rain'"),
        ("dead:top", "There is no LiDAR 'top' in rig 'edgar'"),
        ("dead", "There is no LiDAR '' in rig 'edgar'"),
        ("rain:left", "There is no disturbance 'rain:left'"),
        ("dead:<lidar>", "There is no LiDAR '<lidar>'"),
    ],
)
def test_unknown_disturbances_are_named(text, message):
    with pytest.raises(UnknownNameError, match=message):
        require_known((text,), "edgar", ["front", "left", "rear", "right"])
