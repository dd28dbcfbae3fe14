# SPDX-License-Identifier: Apache-2.0
"""What the plan of a fleet promises."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import RigidTransform
from multilica.simulate import FleetPlan, PlannedLog, plan_fleet, simulate_snapshot, thinned, true_extrinsics
from multilica.simulate.fleet import PlannedEvent

DAY_NS = 86_400 * 10**9


@pytest.fixture(scope="module")
def plan() -> FleetPlan:
    return plan_fleet()


def moved_by(plan: FleetPlan, first: PlannedLog, second: PlannedLog) -> dict[str, tuple[float, float]]:
    """Metres and radians by LiDAR from one log to another."""
    before, after = plan.true_poses(first), plan.true_poses(second)
    return {name: pose.distance_to(before[name]) for name, pose in after.items()}


def is_still(moved: dict[str, tuple[float, float]]) -> bool:
    """Whether no LiDAR moved, but for rounding."""
    return max(max(motion) for motion in moved.values()) < 1e-12


def events_of(plan: FleetPlan, kind: str) -> list[PlannedEvent]:
    return [event for event in plan.events if event.kind == kind]


def test_the_usual_fleet_has_the_usual_numbers(plan):
    assert (len(plan.build_seeds), len(plan.logs)) == (20, 200)
    assert Counter(event.kind for event in plan.events) == {"jump": 3, "creep": 2, "dead": 1}
    assert len({event.vehicle for event in plan.events}) == 6
    assert sum(bool(log.fault) for log in plan.logs) == 10
    assert {log.fault for log in plan.logs} == {"", "truncated", "zeros", "empty", "text", "lfs_pointer"}
    assert sum(bool(log.duplicate_of) for log in plan.logs) == 2
    assert len({log.path for log in plan.logs}) == 200
    assert set(Counter(log.format for log in plan.logs).values()) <= set(range(35, 65))


@pytest.mark.parametrize("seed", range(5))
def test_events_can_be_dated(seed):
    plan = plan_fleet(seed=seed)
    for event in plan.events:
        logs = plan.logs_of(event.vehicle)
        assert event.lidar != plan.target
        if event.kind == "creep":
            assert not logs[0].fault
            assert not logs[-1].fault
            continue
        beside = logs[event.first_log - 3 : event.first_log + 3]
        assert len(beside) == 6
        assert not any(log.fault for log in beside)
        assert logs[event.first_log - 1].time_ns < event.time_ns < logs[event.first_log].time_ns


def test_a_jump_moves_one_lidar_between_two_logs(plan):
    for event in events_of(plan, "jump"):
        logs = plan.logs_of(event.vehicle)
        moved = moved_by(plan, logs[event.first_log - 1], logs[event.first_log])
        shift_m, turn_rad = moved.pop(event.lidar)
        assert 0.03 <= shift_m <= 0.08
        assert 0.3 <= np.rad2deg(turn_rad) <= 1.0
        assert is_still(moved)
        assert is_still(moved_by(plan, logs[0], logs[event.first_log - 1]))
        assert is_still(moved_by(plan, logs[event.first_log], logs[-1]))


def test_a_creep_goes_on_in_proportion_to_time(plan):
    for event in events_of(plan, "creep"):
        first, *others = plan.logs_of(event.vehicle)
        for log in others:
            months = (log.time_ns - first.time_ns) / (30 * DAY_NS)
            moved = moved_by(plan, first, log)
            shift_m, turn_rad = moved.pop(event.lidar)
            assert shift_m / months == pytest.approx(np.linalg.norm(event.shift_m))
            assert turn_rad / months == pytest.approx(np.linalg.norm(event.turn_rad))
            assert is_still(moved)
        assert 0.002 <= np.linalg.norm(event.shift_m) <= 0.004


def test_a_dead_lidar_stays_dead_where_it_is(plan):
    (event,) = events_of(plan, "dead")
    logs = plan.logs_of(event.vehicle)
    assert [log.dead for log in logs] == [() if n < event.first_log else (event.lidar,) for n in range(len(logs))]
    assert is_still(moved_by(plan, logs[0], logs[-1]))
    assert not any(log.dead for log in plan.logs if log.vehicle != event.vehicle)


def test_dates_are_spread_over_a_year(plan):
    start, end = datetime(2025, 10, 1, tzinfo=UTC), datetime(2026, 10, 1, tzinfo=UTC)
    for vehicle in plan.build_seeds:
        logs = plan.logs_of(vehicle)
        times = [datetime.fromtimestamp(log.time_ns / 1e9, UTC) for log in logs]
        assert start <= times[0] < times[-1] < end
        assert all(one < other for one, other in pairwise(times))
        for log, time in zip(logs, times, strict=True):
            assert log.path.startswith(f"{vehicle}/{time:%Y-%m-%d}_")
    gaps_ns = np.concatenate([np.diff([log.time_ns for log in plan.logs_of(name)]) for name in plan.build_seeds])
    assert gaps_ns.std() > 0.5 * gaps_ns.mean()


def test_vehicles_differ_in_their_mounting(plan):
    one, other = (plan.logs_of(name)[0] for name in list(plan.build_seeds)[:2])
    first, second = plan.true_poses(one), plan.true_poses(other)
    assert min(first[name].distance_to(second[name])[0] for name in ("front", "rear", "right")) > 1e-3


def test_the_same_seed_gives_the_same_plan(plan):
    again, other = plan_fleet(), plan_fleet(seed=1)
    texts = [
        [(log.path, log.time_ns, log.scene, log.seed, log.fault, log.duplicate_of) for log in each.logs]
        for each in (plan, again, other)
    ]
    assert texts[0] == texts[1] != texts[2]
    assert plan.events == again.events != other.events


def test_small_fleets_have_what_fits():
    plan = plan_fleet(3, 12)
    assert [event.kind for event in plan.events if event.kind == "jump"] == []
    assert len(plan.events) == 2
    assert sum(bool(log.fault) for log in plan.logs) == 1
    calm = plan_fleet(3, 12, jumps=0, creeps=0, dead=0, broken=0, duplicates=0)
    assert calm.events == ()
    assert not any(log.fault or log.duplicate_of or log.moved or log.dead for log in calm.logs)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"vehicles": 0}, "0 vehicles"),
        ({"vehicles": 5, "logs": 4}, "4 logs"),
        ({"vehicles": 3, "logs": 12, "jumps": 1}, "jump"),
        ({"vehicles": 3, "logs": 30, "jumps": 4}, "jump"),
        ({"vehicles": 2, "logs": 20, "creeps": 2, "dead": 1, "jumps": 0}, "dead"),
        ({"vehicles": 1, "logs": 6, "jumps": 1, "broken": 1, "duplicates": 0}, "broken"),
        ({"seed": -1}, "seed -1"),
        ({"broken": -1}, "-1 broken"),
        ({"frames": 0}, "found"),
    ],
)
def test_impossible_fleets_are_refused(options, named):
    with pytest.raises(UsageError, match=named):
        plan_fleet(**options)


def test_a_moved_lidar_sees_from_its_new_place():
    motion = RigidTransform.from_xyz_rpy("left", "left", (0.05, 0.0, 0.0), (0.0, 0.0, 0.01))
    still = simulate_snapshot("sides", "garage", 3, frames=1, sensors="ideal")
    moved = simulate_snapshot("sides", "garage", 3, frames=1, moved={"left": motion}, start_ns=10**18, sensors="ideal")
    expected = still.truth.T_target_source["left"] @ motion
    np.testing.assert_array_equal(moved.truth.T_target_source["left"].matrix, expected.matrix)
    np.testing.assert_array_equal(moved.snapshot["top"].points_m, still.snapshot["top"].points_m)
    assert moved.snapshot["left"].points_count != still.snapshot["left"].points_count
    for one, other in zip(moved.snapshot.static_transforms, still.snapshot.static_transforms, strict=True):
        np.testing.assert_array_equal(one.matrix, other.matrix)
    assert {scan.stamp_ns for lidar in moved.snapshot.lidars for scan in lidar.scans} == {10**18}
    truth = true_extrinsics("sides", 3, {"left": motion})
    np.testing.assert_array_equal(truth.T_target_source["left"].matrix, expected.matrix)


def test_unknown_names_of_motions_are_refused():
    with pytest.raises(UnknownNameError, match="roof"):
        true_extrinsics("sides", 3, {"roof": RigidTransform.identity("roof", "roof")})
    with pytest.raises(UnknownNameError, match="sdies"):
        true_extrinsics("sdies", 3)


def test_thinned_frames_cover_different_beams():
    snapshot = simulate_snapshot("sides", "garage", 3, frames=2, sensors="ideal").snapshot
    some = thinned(snapshot, 7)
    for lidar in snapshot.lidars:
        for index, (scan, kept) in enumerate(zip(lidar.scans, some[lidar.name].scans, strict=True)):
            np.testing.assert_array_equal(kept.points_m, scan.points_m[index::7])
