# SPDX-License-Identifier: Apache-2.0
"""What a simulated snapshot promises."""

from __future__ import annotations

import functools
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.errors import UnknownNameError, UsageError
from multilica.simulate import RIGS, SCENES, Simulation, simulate_snapshot
from multilica.simulate.simulation import Sensors
from tests.selection import some_of

DECIDABLE_SCENES = ("garage", "open_field", "parking", "street")


@functools.cache
def simulated(rig: str, scene: str, seed: int, sensors: Sensors = "real") -> Simulation:
    """One frame, made once for all tests that look at it; ideal sensors show where surfaces are in half the time."""
    return simulate_snapshot(rig, scene, seed, frames=1, sensors=sensors)


def points_in_base(simulation: Simulation, lidar: str, *, beyond_m: float = 1.0, within_m: float = 200.0) -> np.ndarray:
    """Returns of a LiDAR in the base frame, without those of the vehicle's own body."""
    points = simulation.snapshot[lidar].points_m
    ranges = np.linalg.norm(points, axis=1)
    kept = points[(ranges > beyond_m) & (ranges < within_m)]
    return simulation.truth.T_target_source[lidar].apply(kept)


@functools.cache
def tree_of(simulation: Simulation, lidar: str) -> cKDTree:
    return cKDTree(points_in_base(simulation, lidar))


def shared_share(simulation: Simulation, target: str, source: str, within_m: float = 0.3) -> float:
    """Share of the source's points that lie near a point of the target."""
    found = tree_of(simulation, target).query(points_in_base(simulation, source)[::29], distance_upper_bound=within_m)[
        0
    ]
    return float(np.isfinite(found).mean())


@pytest.mark.slow
@pytest.mark.parametrize("rig", some_of(sorted(RIGS), 2))
def test_same_arguments_give_the_same_bits(rig):
    disturbances = ("rain", "truck", "pedestrians") if rig == "blind" else ("rain",)
    first, second = (simulate_snapshot(rig, "garage", 4, frames=1, disturbances=disturbances) for _ in range(2))
    for one, other in zip(first.snapshot.lidars, second.snapshot.lidars, strict=True):
        assert [scan.stamp_ns for scan in one.scans] == [scan.stamp_ns for scan in other.scans]
        for scan, again in zip(one.scans, other.scans, strict=True):
            np.testing.assert_array_equal(scan.points_m, again.points_m)
    for name, pose in first.truth.T_target_source.items():
        np.testing.assert_array_equal(pose.matrix, second.truth.T_target_source[name].matrix)


@pytest.mark.slow
@pytest.mark.in_turn
def test_another_process_gives_the_same_bits():
    program = (
        "from multilica.simulate import simulate_snapshot;"
        "cloud = simulate_snapshot('sides', 'street', 2, frames=1).snapshot['left'].points_m;"
        "print(cloud.shape, cloud.tobytes().hex()[:4000])"
    )
    elsewhere = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    cloud = simulated("sides", "street", 2).snapshot["left"].points_m
    assert elsewhere.strip() == f"{cloud.shape} {cloud.tobytes().hex()[:4000]}"


@pytest.mark.slow
def test_seeds_differ_in_mounting_and_surroundings():
    first, second = (simulated("sides", "parking", seed) for seed in (1, 2))
    shift_m, turn_rad = first.truth.T_target_source["top"].distance_to(second.truth.T_target_source["top"])
    assert shift_m > 1e-3
    assert turn_rad > 1e-4
    assert first.snapshot["top"].points_count != second.snapshot["top"].points_count


@pytest.mark.slow
def test_the_same_vehicle_stands_in_another_scene():
    first = simulate_snapshot("sides", "parking", 1, frames=1)
    second = simulate_snapshot("sides", "garage", 2, frames=1, build_seed=1)
    for name, pose in first.truth.T_target_source.items():
        np.testing.assert_array_equal(second.truth.T_target_source[name].matrix, pose.matrix)
    for one, other in zip(first.snapshot.static_transforms, second.snapshot.static_transforms, strict=True):
        np.testing.assert_array_equal(one.matrix, other.matrix)
    own = simulated("sides", "garage", 2)
    assert second.snapshot["top"].points_count != own.snapshot["top"].points_count
    assert second.snapshot.source == "simulation sides/garage/seed 2, vehicle 1"


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("scene", DECIDABLE_SCENES)
def test_truth_lays_clouds_onto_each_other(scene):
    simulation = simulated("edgar", scene, 3)
    dense = points_in_base(simulation, "left", within_m=14.0)
    other = points_in_base(simulation, "front", within_m=12.0)[::10]
    distances = cKDTree(dense).query(other, distance_upper_bound=0.3)[0]
    shared = distances[np.isfinite(distances)]
    assert len(shared) > 300
    assert np.median(shared) < 0.06


def test_flat_surfaces_agree_to_the_range_noise():
    simulation = simulated("helipr", "symmetric_garage", 1)
    for lidar in simulation.snapshot.names:
        points = points_in_base(simulation, lidar)
        floor = points[(np.abs(points[:, 2]) < 0.08) & (np.linalg.norm(points[:, :2], axis=1) < 12.0)]
        if len(floor) > 100:
            assert abs(float(np.median(floor[:, 2]))) < 0.005
            assert float(np.std(floor[:, 2])) < 0.025


@pytest.mark.parametrize("scene", sorted(SCENES))
@pytest.mark.in_turn
def test_base_frame_lies_on_the_ground(scene):
    simulation = simulated("sides", scene, 5, "ideal")
    points = np.concatenate([points_in_base(simulation, name) for name in simulation.snapshot.names])
    beside = points[(np.abs(points[:, 0]) < 3.0) & (np.abs(points[:, 1]) < 3.5) & (np.abs(points[:, 2]) < 0.3)]
    assert len(beside) > 300
    assert abs(float(np.median(beside[:, 2]))) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("rig", some_of(sorted(RIGS), 2))
def test_returns_stay_within_the_field_of_view(rig):
    simulation = simulated(rig, "street", 1)
    for mount in RIGS[rig].mounts:
        points = simulation.snapshot[mount.name].points_m
        ranges = np.linalg.norm(points, axis=1)
        elevation = np.rad2deg(np.arcsin(points[:, 2] / ranges))
        azimuth = np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))
        half_deg = getattr(mount.sensor.pattern, "vertical_fov_deg", 0.0) / 2.0
        low, high = getattr(mount.sensor.pattern, "elevation_deg", (-half_deg, half_deg))
        assert len(points) > 1000
        assert low - 0.01 <= elevation.min() < elevation.max() <= high + 0.01
        assert np.abs(azimuth).max() <= mount.sensor.pattern.horizontal_fov_deg / 2.0 + 0.01
        # The limits are those of true ranges.
        off_m = 5.0 * mount.sensor.accuracy.range_m
        assert mount.sensor.min_range_m - off_m <= ranges.min() < ranges.max() <= mount.sensor.max_range_m + off_m


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("rig", sorted(RIGS))
def test_built_rig_is_near_its_drawing_but_not_on_it(rig):
    truth = simulated(rig, "tunnel", 7).truth
    assert truth.target == "base"
    for mount in RIGS[rig].mounts:
        shift_m, turn_rad = mount.T_base_lidar.distance_to(truth.T_target_source[mount.name])
        assert 1e-3 < shift_m < 0.12
        assert 1e-4 < turn_rad < np.deg2rad(6.0)


@pytest.mark.slow
def test_static_transforms_are_a_prior_but_not_the_truth():
    shifts_m, turns_rad = [], []
    for seed in range(12):
        simulation = simulated("blind", "tunnel", seed)
        for claimed in simulation.snapshot.static_transforms:
            assert claimed.target == "base"
            shift_m, turn_rad = claimed.distance_to(simulation.truth.T_target_source[claimed.source])
            shifts_m.append(shift_m)
            turns_rad.append(turn_rad)
    assert 0.05 < np.sqrt(np.mean(np.square(shifts_m))) < 0.12
    assert np.deg2rad(2.0) < np.sqrt(np.mean(np.square(turns_rad))) < np.deg2rad(5.0)


@pytest.mark.parametrize("scene", DECIDABLE_SCENES)
def test_blind_rig_has_a_lidar_that_shares_no_surface(scene):
    simulation = simulated("blind", scene, 2, "ideal")
    assert shared_share(simulation, "front_left", "front_right") > 0.1
    assert shared_share(simulation, "front_left", "rear") < 0.01
    assert shared_share(simulation, "front_right", "rear") < 0.01


@pytest.mark.parametrize("scene", DECIDABLE_SCENES)
def test_chain_overlaps_between_neighbours_only(scene):
    simulation = simulated("chain", scene, 2, "ideal")
    order = [mount.name for mount in RIGS["chain"].mounts]
    for first in range(4):
        for second in range(first + 1, 4):
            share = shared_share(simulation, order[first], order[second])
            assert share > 0.08 if second == first + 1 else share < 0.01


@pytest.mark.slow
def test_edgar_has_no_field_of_view_common_to_all():
    simulation = simulated("edgar", "parking", 2)
    assert shared_share(simulation, "front", "rear") < 0.01
    for end in ("front", "rear"):
        for side in ("left", "right"):
            assert shared_share(simulation, side, end) > 0.2


@pytest.mark.slow
def test_symmetric_garage_looks_the_same_after_half_a_turn():
    shares = {}
    for scene in ("symmetric_garage", "garage"):
        simulation = simulated("edgar", scene, 1)
        cloud = np.concatenate([points_in_base(simulation, name) for name in simulation.snapshot.names])
        cloud = cloud[np.linalg.norm(cloud[:, :2], axis=1) < 12.0]
        distances = cKDTree(cloud).query(cloud[::200] * [-1.0, -1.0, 1.0])[0]
        shares[scene] = float((distances < 0.15).mean())
    assert shares["symmetric_garage"] > 0.9
    assert shares["garage"] < shares["symmetric_garage"] - 0.1


@pytest.mark.slow
def test_frames_are_ten_per_second_and_go_on():
    simulation = simulate_snapshot("helipr", "street", 1, frames=3)
    for lidar in simulation.snapshot.lidars:
        stamps = [scan.stamp_ns for scan in lidar.scans]
        assert np.diff(stamps).tolist() == [100_000_000, 100_000_000]
        assert lidar.topic == f"/lidar/{lidar.name}/points"
        assert lidar.frame_id == lidar.name
        assert not np.array_equal(lidar.scans[0].points_m[:500], lidar.scans[1].points_m[:500])


def test_ground_fades_with_range():
    simulation = simulated("helipr", "fence_field", 1, "ideal")
    points = points_in_base(simulation, "ouster")
    radius = np.linalg.norm(points[np.abs(points[:, 2]) < 0.1][:, :2], axis=1)
    rings = [np.histogram(radius, bins=[low, low * 1.1])[0][0] * low for low in (15.0, 60.0)]
    assert rings[1] < 0.7 * rings[0]


def test_unknown_names_are_named():
    for rig, scene, word in (("egdar", "street", "edgar"), ("edgar", "stret", "street")):
        with pytest.raises(UnknownNameError, match=f"Did you mean '{word}'"):
            simulate_snapshot(rig, scene, 1)


@pytest.mark.parametrize(("seed", "frames"), [(-1, 5), (1, 0)])
def test_impossible_counts_are_refused(seed, frames):
    with pytest.raises(UsageError, match="at least"):
        simulate_snapshot("edgar", "street", seed, frames=frames)


@pytest.mark.slow
def test_names_of_rigs_come_without_open3d():
    program = (
        "import sys; from multilica.simulate import DISTURBANCES, RIGS, SCENES; assert 'open3d' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
