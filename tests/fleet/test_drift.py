# SPDX-License-Identifier: Apache-2.0
from functools import cache

import numpy as np
import pytest

from multilica.errors import UsageError
from multilica.fleet.drift.drift import find_drift
from multilica.fleet.lidar_series import LidarSeries
from multilica.geometry import RigidTransform
from tests.fleet.made_series import DAY_NS, START_NS, Motion, Noise, made_fleet, made_vehicle
from tests.selection import some_of

_SHIFT = (0.0, 0.0, 0.0, 0.0, 0.03, 0.0)
_TURN = (0.0, 0.0, np.deg2rad(0.4), 0.0, 0.0, 0.0)
_RIG = ("left", "right", "rear")


def _rng(seed):
    return np.random.default_rng(seed)


def _weekly(count):
    return START_NS + 7 * DAY_NS * np.arange(count)


@cache
def _others(lidars):
    return made_fleet(_rng(100), 6, 10, lidars=lidars)


def _events(vehicle, lidars=("left",)):
    """Of one vehicle in a fleet of six more that do not change."""
    events = find_drift([*_others(lidars), *vehicle])
    assert {event.vehicle for event in events} <= {"v01"}
    return events


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 12, 40])
@pytest.mark.parametrize(
    "noise", [Noise(), Noise(factors=(1.0, 3.0)), Noise(scene_m=0.003, scene_deg=0.03)], ids=["true", "small", "scenes"]
)
def test_a_fleet_at_rest_has_no_event(count, noise):
    assert find_drift(made_fleet(_rng(count), 8, count, noise=noise, lidars=("left", "rear"))) == []


@pytest.mark.parametrize("depots", [0, 1, 2, 5])
@pytest.mark.parametrize("count", [4, 12, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.in_turn
def test_biases_and_new_depots_are_no_event(count, depots):
    noise = Noise(constant=0.25, place=0.6, depots=depots)
    fleet = made_fleet(_rng(count), 8, count, noise=noise, lidars=("left", "rear"))
    assert find_drift(fleet) == []
    offset = np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.0])
    moved = made_vehicle(
        _rng(1), max(count, 5), noise=noise, lidars=("left", "rear"), motions={"left": Motion(offset, 2)}
    )
    events = find_drift([*fleet, *moved])
    assert [(event.kind, event.lidars, event.vehicle) for event in events] == [("jump", ("left",), "v01")]


@pytest.mark.parametrize("seed", some_of(range(4), 2))
@pytest.mark.parametrize("offset", [_SHIFT, _TURN], ids=["30 mm", "0.4 deg"])
@pytest.mark.parametrize("index", [2, 5, 10])
def test_a_jump_is_found_and_dated(seed, offset, index):
    made = made_vehicle(_rng(seed), 12, lidars=("left", "right"), motions={"left": Motion(offset, index=index)})
    (event,) = _events(made, lidars=("left", "right"))
    assert (event.kind, event.moved, event.lidars) == ("jump", "lidar", ("left",))
    assert (event.last_before_key, event.key) == (f"v01-{index - 1:03d}", f"v01-{index:03d}")
    assert event.time_ns == made[0].time_ns[index]
    assert event.last_before_time_ns == made[0].time_ns[index - 1]
    assert event.p_value < 1e-3
    assert event.per_30_days is None
    np.testing.assert_allclose(event.translation_m, offset[3:], atol=0.008)
    np.testing.assert_allclose(event.rotation_rad, offset[:3], atol=np.deg2rad(0.08))


def test_several_jumps_are_told_apart():
    first = made_vehicle(_rng(1), 24, motions={"left": Motion(_SHIFT, index=8)})[0]
    back = np.array([-2.0 * value for value in _SHIFT])
    poses = [
        RigidTransform.from_rotation_translation("top", "left", pose.rotation, pose.xyz_m + (index >= 15) * back[3:])
        for index, pose in enumerate(first.T_target_lidar)
    ]
    made = LidarSeries("v01", "left", "top", first.keys, first.time_ns, tuple(poses), first.covariances)
    assert [(event.kind, event.key) for event in _events([made])] == [("jump", "v01-008"), ("jump", "v01-015")]


@pytest.mark.parametrize("seed", some_of(range(4), 2))
def test_a_creep_is_told_from_a_jump(seed):
    rate = np.array([0.0, 0.0, 0.0, 0.004, 0.0, 0.0])
    made = made_vehicle(_rng(seed), 20, lidars=("left", "right"), motions={"left": Motion(rate)})
    (event,) = _events(made, lidars=("left", "right"))
    assert (event.kind, event.moved, event.lidars) == ("creep", "lidar", ("left",))
    translation_m, _ = event.per_30_days
    np.testing.assert_allclose(translation_m, rate[3:], atol=0.001)
    assert (event.last_before_key, event.last_key) == ("v01-000", "v01-019")
    assert "v01-000" < event.key < "v01-019"


def test_a_creep_that_is_repaired_is_a_creep_and_a_jump():
    made = made_vehicle(
        _rng(5), 30, times=_weekly(30), motions={"left": Motion((0.0, 0.0, 0.0, 0.0, 0.0, 0.01), since_days=0.0)}
    )[0]
    repaired_m = made_vehicle(_rng(6), 30, times=_weekly(30))[0]
    poses = (*made.T_target_lidar[:20], *repaired_m.T_target_lidar[20:])
    series = LidarSeries("v01", "left", "top", made.keys, made.time_ns, poses, made.covariances)
    creep, jump = sorted(_events([series]), key=lambda event: event.kind)
    assert (creep.kind, creep.last_before_key, creep.last_key) == ("creep", "v01-000", "v01-019")
    assert (jump.kind, jump.key) == ("jump", "v01-020")


@pytest.mark.parametrize("seed", some_of(range(3), 1))
@pytest.mark.parametrize(
    "offset", [(0, 0, 0, 0.03, 0, 0), (0, np.deg2rad(0.5), np.deg2rad(0.5), 0.0, 0.02, 0.0)], ids=["shift", "turn"]
)
@pytest.mark.parametrize("lidars", [_RIG[:2], _RIG])
def test_a_target_that_moved_is_one_event(seed, offset, lidars):
    made = made_vehicle(_rng(seed), 12, lidars=lidars, motions={"top": Motion(offset, index=6)})
    (event,) = _events(made, lidars=lidars)
    assert (event.kind, event.moved, event.key, event.lidars) == ("jump", "target", "v01-006", tuple(sorted(lidars)))
    np.testing.assert_allclose(event.translation_m, offset[3:], atol=0.012)
    np.testing.assert_allclose(event.rotation_rad, offset[:3], atol=np.deg2rad(0.08))
    assert event.sentence.startswith("v01: the target top moved by ")


def test_a_target_that_creeps_is_one_event():
    rate = (0.0, 0.0, np.deg2rad(0.05), 0.0, 0.005, 0.0)
    made = made_vehicle(_rng(3), 20, lidars=_RIG, motions={"top": Motion(rate)})
    (event,) = _events(made, lidars=_RIG)
    assert (event.kind, event.moved) == ("creep", "target")
    np.testing.assert_allclose(event.per_30_days[0], rate[3:], atol=0.0015)
    np.testing.assert_allclose(event.per_30_days[1], rate[:3], atol=np.deg2rad(0.015))


def test_two_lidars_that_moved_apart_are_two_events():
    motions = {"left": Motion(_SHIFT, index=6), "right": Motion(tuple(np.negative(_SHIFT)), index=6)}
    events = _events(made_vehicle(_rng(3), 12, lidars=_RIG, motions=motions), lidars=_RIG)
    assert [(event.moved, event.lidars, event.key) for event in events] == [
        ("lidar", ("left",), "v01-006"),
        ("lidar", ("right",), "v01-006"),
    ]


def test_a_single_lidar_is_not_told_from_its_target():
    (event,) = _events(made_vehicle(_rng(3), 12, motions={"left": Motion(_SHIFT, index=6)}))
    assert event.moved == "lidar or target"
    assert event.sentence.startswith("v01: left or the target top moved by ")


@pytest.mark.parametrize("size_m", [0.03, 0.3, 10.0])
@pytest.mark.parametrize("index", [0, 1, 5, 10, 11])
def test_one_wrong_log_is_no_event(size_m, index):
    series = made_vehicle(_rng(7), 12)[0]
    poses = list(series.T_target_lidar)
    off = np.array([size_m, size_m, 0.0])
    poses[index] = RigidTransform.from_rotation_translation(
        "top", "left", poses[index].rotation, poses[index].xyz_m + off
    )
    wrong = LidarSeries("v01", "left", "top", series.keys, series.time_ns, tuple(poses), series.covariances)
    assert _events([wrong]) == []


def test_a_jump_waits_for_a_second_log():
    made = made_vehicle(_rng(8), 12, times=_weekly(12), motions={"left": Motion(_SHIFT, index=10)})[0]
    before = LidarSeries(
        "v01", "left", "top", made.keys[:11], made.time_ns[:11], made.T_target_lidar[:11], made.covariances[:11]
    )
    assert _events([before]) == []
    assert [event.key for event in _events([made])] == ["v01-010"]


@pytest.mark.parametrize("index", [201, 498])
def test_a_jump_in_a_long_series_is_dated(index):
    times = START_NS + DAY_NS // 2 * np.arange(500)
    (event,) = _events(made_vehicle(_rng(9), 500, times=times, motions={"left": Motion(_SHIFT, index=index)}))
    assert (event.kind, event.key) == ("jump", f"v01-{index}")


def test_a_lone_vehicle_is_judged_with_care():
    noise = Noise(factors=(3.0, 3.0))
    for seed in range(20):
        assert find_drift(made_vehicle(_rng(seed), 4, noise=noise)) == []
    made = made_vehicle(_rng(0), 12, motions={"left": Motion((0, 0, 0, 0.1, 0, 0), index=6)})
    assert [event.key for event in find_drift(made)] == ["v01-006"]


def test_sentences_name_part_size_and_dates():
    times = _weekly(12)
    motions = {"left": Motion((0.0, 0.0, np.deg2rad(0.4), 0.031, 0.0, 0.0), index=6)}
    noise = Noise(sigma_m=1e-6, sigma_deg=1e-5)
    (jump,) = find_drift(made_vehicle(_rng(1), 12, lidars=_RIG, times=times, motions=motions, noise=noise))
    assert jump.sentence == "v01: left moved by 31 mm and 0.40 deg between 2026-02-05 and 2026-02-12."
    motions = {"left": Motion((0.0, 0.0, 0.0, 0.0, 0.025, 0.0))}
    (creep,) = find_drift(made_vehicle(_rng(1), 12, lidars=_RIG, times=times, motions=motions, noise=noise))
    assert creep.sentence == "v01: left creeps by 25 mm and 0.00 deg per 30 days since 2026-01-01."
    times = START_NS + DAY_NS // 24 * np.arange(12)
    motions = {"left": Motion(_SHIFT, index=6)}
    (jump,) = find_drift(made_vehicle(_rng(1), 12, lidars=_RIG, times=times, motions=motions, noise=noise))
    assert jump.sentence == "v01: left moved by 30 mm and 0.00 deg between 2026-01-01 05:00 and 2026-01-01 06:00."


def test_the_order_of_the_series_changes_nothing():
    made = made_vehicle(_rng(3), 12, lidars=_RIG, motions={"rear": Motion(_SHIFT, index=6)})
    fleet = made_fleet(_rng(4), 5, 10, lidars=_RIG)
    one, other = find_drift([*made, *fleet]), find_drift([*fleet[::-1], *made[::-1]])
    assert [event.sentence for event in one] == [event.sentence for event in other]
    assert len(one) == 1


@pytest.mark.parametrize("rate", [0.0, 0.5, -1.0, float("nan")])
def test_a_wrong_rate_is_refused(rate):
    with pytest.raises(UsageError, match="expected a number above 0 and below"):
        find_drift([], rate)


def test_two_series_of_one_lidar_are_refused():
    with pytest.raises(ValueError, match="two series of left of v01"):
        find_drift(made_vehicle(_rng(1), 4) * 2)
