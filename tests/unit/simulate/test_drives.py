# SPDX-License-Identifier: Apache-2.0
"""A simulated drive: the same vehicle at stops whose places are known, with all that changes between them."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate import FIRST_STOP, RIGS, ROUTES, SimulatedDrive, drives, simulate_drive, simulate_snapshot
from multilica.simulate.routes import Leg, plan_legs
from multilica.simulate.shapes.mesh import merged
from multilica.simulate.world import Exposure, _rolling
from tests.selection import some_of

CHEAP = {"frames": 1, "sensors": "ideal"}


@functools.cache
def driven(rig: str, scene: str, route: str, **options: object) -> SimulatedDrive:
    return simulate_drive(rig, scene, 2, route=route, **{**CHEAP, "stops": 3, "keep_every": 4} | options)


def cloud_m(drive: SimulatedDrive, stop: int) -> FloatArray:
    """All returns of a stop in the vehicle's frame at the first one, without those of the vehicle itself."""
    poses = drive.truths[stop].T_target_source
    in_base = np.concatenate([poses[each.name].apply(each.points_m) for each in drive.snapshots[stop].lidars])
    far = np.linalg.norm(in_base[:, :2], axis=1) > 7.5
    return drive.T_first_stop_base[stop].apply(in_base[far])


def frames(drive: SimulatedDrive, stop: int, lidar: str) -> list[bytes]:
    return [scan.points_m.tobytes() for scan in drive.snapshots[stop][lidar].scans]


@pytest.mark.parametrize(
    ("rig", "scene", "route"),
    [
        ("front_back", "yard", "turning"),
        pytest.param("corners", "town", "turning", marks=pytest.mark.nightly),
        pytest.param("narrow4", "motorway_exit", "exit", marks=pytest.mark.nightly),
        pytest.param("trailer", "yard", "yard", marks=pytest.mark.nightly),
        pytest.param("front_back", "equal_houses", "straight", marks=pytest.mark.nightly),
    ],
)
def test_truth_lays_all_stops_onto_each_other(rig: str, scene: str, route: str) -> None:
    """Nearby surfaces of the last stop lie on those of the first, and not beside them."""
    drive = driven(rig, scene, route, keep_every=1)
    first, last_m = cKDTree(cloud_m(drive, 0)), cloud_m(drive, 2)
    upright_m = last_m[(last_m[:, 2] > 0.5) & (last_m[:, 2] < 3.0)]
    near_m = upright_m[np.linalg.norm(upright_m - drive.T_first_stop_base[2].xyz_m, axis=1) < 20.0][::10]
    found_m = [first.query(near_m + shift_m, distance_upper_bound=1.0)[0] for shift_m in (0.0, 0.3)]
    assert np.isfinite(found_m[0]).sum() > 200
    touching, beside = (float(np.mean(each[np.isfinite(each)] < 0.1)) for each in found_m)
    assert touching > 0.3
    assert touching > 2.0 * beside


def test_the_first_stop_is_that_of_a_snapshot() -> None:
    """Bit for bit, but for what stands in the vehicle's way later."""
    drive = simulate_drive("front_back", "open_field", 3, route="straight", stops=1, **CHEAP)
    alone = simulate_snapshot("front_back", "open_field", 3, **CHEAP)
    for mine, other in zip(drive.snapshots[0].lidars, alone.snapshot.lidars, strict=True):
        np.testing.assert_array_equal(mine.scans[0].points_m, other.scans[0].points_m)
    assert drive.truth.T_target_source.keys() == alone.truth.T_target_source.keys()
    (pose,) = drive.T_first_stop_base
    assert (pose.target, pose.source) == (FIRST_STOP, "base")
    np.testing.assert_allclose(pose.matrix, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("stops", [2, 3, 4, 7])
def test_routes_turn_as_they_say(stops: int) -> None:
    for seed in range(3):
        legs = {route: plan_legs(route, stops, np.random.default_rng(seed), None) for route in ROUTES}
        assert {len(each) for each in legs.values()} == {stops - 1}
        turns_deg = {route: np.rad2deg(sum(leg.turn_rad for leg in each)) for route, each in legs.items()}
        assert abs(turns_deg["turning"]) == pytest.approx(180.0)
        assert abs(turns_deg["straight"]) < 2.0 * stops
        assert turns_deg["exit"] < -10.0 * (stops - 1)
        assert abs(turns_deg["yard"]) > 29.0 * (stops - 1)
        assert all(5.0 < leg.length_m < 7.0 for leg in legs["straight"])
        bent = [leg for leg in legs["turning"] + legs["yard"] if abs(leg.turn_rad) > 0.1]
        assert min(abs(leg.length_m / leg.turn_rad) for leg in bent) > 4.9


def test_an_arc_ends_where_its_pieces_end() -> None:
    x_m, y_m, yaw_rad = Leg(5.0, 0.5).end((0.0, 0.0, 0.0))
    assert (x_m, y_m, yaw_rad) == pytest.approx((10.0 * np.sin(0.5), 10.0 * (1.0 - np.cos(0.5)), 0.5))
    (leg,) = plan_legs("yard", 2, np.random.default_rng(1), None)
    whole, place = leg.end((1.0, 2.0, 0.3)), (1.0, 2.0, 0.3)
    for _ in range(4):
        place = Leg(leg.length_m / 4, leg.turn_rad / 4).end(place)
    np.testing.assert_allclose(place, whole)
    np.testing.assert_allclose(leg.end((1.0, 2.0, 0.3), 0.0), (1.0, 2.0, 0.3))


def test_a_lidar_is_knocked_from_a_stop_on() -> None:
    knock = RigidTransform.from_xyz_rpy("rear", "rear", (0.02, 0.0, 0.0), (0.0, 0.0, 0.0))
    still = driven("front_back", "yard", "turning")
    drive = simulate_drive("front_back", "yard", 2, stops=3, keep_every=4, moved={"rear": knock}, moved_from=1, **CHEAP)
    shifts_m = [
        truth.T_target_source["rear"].distance_to(still.truth.T_target_source["rear"])[0] for truth in drive.truths
    ]
    assert shifts_m == pytest.approx([0.0, 0.02, 0.02])
    assert [frames(drive, stop, "rear") == frames(still, stop, "rear") for stop in range(3)] == [True, False, False]
    assert all(frames(drive, stop, "front") == frames(still, stop, "front") for stop in range(3))


@pytest.mark.slow
@pytest.mark.in_turn
def test_parked_cars_stand_there_at_some_stops_only(monkeypatch: pytest.MonkeyPatch) -> None:
    still, drive = (driven("front_back", "yard", "turning", parked=count) for count in (0, 3))
    changed = []
    for stop in range(3):
        distances_m = cKDTree(cloud_m(still, stop)).query(cloud_m(drive, stop))[0]
        changed.append(int(np.sum(distances_m > 1.0)))
    assert max(changed) > 100
    assert min(changed) < 0.7 * max(changed)
    monkeypatch.setattr(drives, "_CAR_TRIES", 1)
    with pytest.raises(UsageError, match="parked cars beside the route, expected 30"):
        simulate_drive("front_back", "yard", 2, stops=3, parked=30, **CHEAP)


@pytest.mark.slow
def test_a_log_holds_the_stops_and_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drives, "_LEG_FRAMES", 4)
    few = {"stops": 2, "frames": 2, "keep_every": 200, "sensors": "ideal"}
    stops_only, drive = (simulate_drive("front_back", "yard", 2, with_log=log, **few) for log in (False, True))
    assert stops_only.log is None
    front = drive.log["front"]
    stamps_ns = [scan.stamp_ns for scan in front.scans]
    assert np.unique(np.diff(stamps_ns)).tolist() == [100_000_000]
    assert len(stamps_ns) == 9
    for stop, (first_ns, last_ns) in enumerate(drive.spans_ns):
        taken = [scan for scan in front.scans if first_ns <= scan.stamp_ns <= last_ns]
        assert len(taken) == 2
        for mine, other in zip(taken, drive.snapshots[stop]["front"].scans, strict=True):
            np.testing.assert_array_equal(mine.points_m, other.points_m)
    assert stops_only.spans_ns == drive.spans_ns
    assert all(len(scan.times_ns) == len(scan.points_m) for scan in front.scans)
    assert max(scan.times_ns.max() for scan in front.scans) < 100_000_000


def test_beams_start_where_the_vehicle_is_when_they_are_fired() -> None:
    way = [RigidTransform.from_xyz_rpy("world", "base", (x, 0.0, 0.0), (0.0, 0.0, x / 10.0)) for x in (0.0, 1.0, 2.0)]
    lidar = RigidTransform.from_xyz_rpy("base", "top", (0.0, 0.0, 3.0), (0.0, 0.0, np.pi / 2.0))
    origins_m, directions = _rolling(Exposure(0, 0, lidar, way, merged([])), np.tile([1.0, 0.0, 0.0], (4, 1)))
    np.testing.assert_allclose(origins_m, [[0.5 * index, 0.0, 3.0] for index in range(4)], atol=1e-12)
    yaws_rad = np.arctan2(directions[:, 1], directions[:, 0])
    np.testing.assert_allclose(yaws_rad, [np.pi / 2.0 + 0.05 * index for index in range(4)])


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("rig", some_of(["corners", "front_back", "narrow4", "trailer"], 1))
def test_the_vehicle_is_the_same_at_all_stops(rig: str) -> None:
    """Real LiDARs, whose units depend on the vehicle alone, give the same bits again."""
    first, again = (
        simulate_drive(rig, "yard", 1, stops=2, frames=1, keep_every=8, build_seed=7, disturbances=("pedestrians",))
        for _ in range(2)
    )
    other = simulate_drive(rig, "town", 1, stops=2, frames=1, keep_every=8, build_seed=7)
    for lidar in first.snapshots[0].names:
        assert [frames(first, stop, lidar) for stop in (0, 1)] == [frames(again, stop, lidar) for stop in (0, 1)]
        np.testing.assert_array_equal(
            first.truth.T_target_source[lidar].matrix, other.truth.T_target_source[lidar].matrix
        )


@pytest.mark.parametrize("rig", ["corners", "front_back", "trailer"])
def test_rigs_without_a_common_view(rig: str) -> None:
    """No beam of a LiDAR has the azimuth of a beam of another."""
    spans = [(mount.rpy_deg[2], mount.sensor.pattern.horizontal_fov_deg) for mount in RIGS[rig].mounts]
    for index, (yaw_deg, width_deg) in enumerate(spans):
        for other_deg, other_width_deg in spans[:index]:
            apart_deg = abs((yaw_deg - other_deg + 180.0) % 360.0 - 180.0)
            assert apart_deg > (width_deg + other_width_deg) / 2.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"route": "turning", "disturbances": ("traffic:queue",)}, "Traffic would drive into a vehicle that turns"),
        ({"disturbances": ("moving",)}, "leave out the disturbance 'moving'"),
        ({"stops": 0}, "needs a stop or more"),
        ({"step_m": -1.0}, "needs a stop or more"),
        ({"parked": -1}, "-1 parked cars"),
    ],
)
def test_impossible_drives_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate_drive("front_back", "yard", 1, **{**CHEAP, **options})
    with pytest.raises(UnknownNameError, match="Did you mean 'turning'"):
        simulate_drive("front_back", "yard", 1, route="turnin", **CHEAP)
