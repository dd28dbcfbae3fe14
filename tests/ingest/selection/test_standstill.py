# SPDX-License-Identifier: Apache-2.0
"""The longest stretch in which the vehicle stands still, by whatever shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError
from multilica.ingest import read_snapshot
from multilica.ingest.locate import find_source, locate
from multilica.ingest.opening import open_source
from multilica.ingest.selection import standstill
from multilica.ingest.selection.standstill import find_standstills, richest_topics
from multilica.ingest.selection.topics import cloud_span
from multilica.snapshot import Scan, Snapshot
from tests.ingest.support.recording_writers import (
    CLOUD,
    START_NS,
    cloud_message,
    header,
    make_snapshot,
    ros1_types,
    ros2_types,
    write_mcap,
)

DURATION_S = 20.0
STILL_S = ((3.0, 5.0), (9.0, 16.0))
SPEED_MPS = 2.0
ROOM_M = np.array([9.0, 6.0, 4.0])

Raw = tuple[str, str, int, bytes]


def moving(time_s: float) -> bool:
    return not any(first <= time_s < last for first, last in STILL_S)


def position_m(time_s: float) -> float:
    """Back and forth, so that the room does not end."""
    driven_s = np.arange(0.0, time_s, 0.01)
    return 0.4 * np.sin(SPEED_MPS * 0.01 * sum(map(moving, driven_s)) / 0.4)


def room_scan(time_s: float, seed: int) -> Scan:
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(np.arange(0.0, 2 * np.pi, 0.03), np.deg2rad(np.arange(-38.5, 40.0, 3.0)))
    azimuth = azimuth + rng.uniform(0.0, 0.03)
    flat = np.cos(elevation)
    beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    range_m = np.min((np.sign(beams) * ROOM_M - [position_m(time_s), 0.0, 0.0]) / beams, axis=1)
    points_m = beams * (range_m + rng.normal(scale=0.01, size=len(range_m)))[:, None]
    return Scan(points_m.astype(np.float32), stamp_ns(time_s), np.zeros(len(points_m), np.float32))


def stamp_ns(time_s: float) -> int:
    return START_NS + round(time_s * 1e9)


def clouds(store: Typestore, serialise: Callable[[Any, str], Any], *, real: bool) -> Iterator[Raw]:
    small = make_snapshot(lidars=1, frames=1, points=5).lidars[0].scans[0]
    for number, time_s in enumerate(np.arange(0.0, DURATION_S, 0.2)):
        scan = room_scan(time_s, number) if real else Scan(small.points_m + number, stamp_ns(time_s), small.intensity)
        yield "/points", CLOUD, stamp_ns(time_s), bytes(serialise(cloud_message(store, scan, "roof"), CLOUD))


def odometry_without_speed(store: Typestore, serialise: Callable[[Any, str], Any]) -> Iterator[Raw]:
    yield from odometry(store, serialise, with_speed=False)


def odometry(
    store: Typestore,
    serialise: Callable[[Any, str], Any],
    *,
    with_speed: bool = True,
    speed_mps: float = SPEED_MPS,
    rest_mps: float = 0.0,
) -> Iterator[Raw]:
    types, name = store.types, "nav_msgs/msg/Odometry"
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    driven_m = 0.0
    for time_s in np.arange(0.0, DURATION_S, 0.05):
        driven_m += speed_mps * 0.05 * moving(time_s)
        speed = (speed_mps if moving(time_s) else rest_mps) * with_speed
        twist = types["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, 0.001))
        pose = types["geometry_msgs/msg/Pose"](
            point(driven_m, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        )
        message = types[name](
            header(store, "odom", stamp_ns(time_s)),
            "base",
            types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        yield "/odom", name, stamp_ns(time_s), bytes(serialise(message, name))


def imu(
    store: Typestore,
    serialise: Callable[[Any, str], Any],
    *,
    shake_mps2: float = 0.6,
    unit_mps2: float = 1.0,
    gravity_mps2: float = 9.81,
) -> Iterator[Raw]:
    types, name, rng = store.types, "sensor_msgs/msg/Imu", np.random.default_rng(0)
    vector = types["geometry_msgs/msg/Vector3"]
    for time_s in np.arange(0.0, DURATION_S, 0.01):
        shake = shake_mps2 if moving(time_s) else 0.03
        message = types[name](
            header(store, "imu", stamp_ns(time_s)),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            np.zeros(9),
            vector(*rng.normal(0.0, 0.1 * shake, 3)),
            np.zeros(9),
            vector(*(rng.normal([0.0, 0.0, gravity_mps2], shake) / unit_mps2)),
            np.zeros(9),
        )
        yield "/imu", name, stamp_ns(time_s), bytes(serialise(message, name))


EVIDENCE = [
    ("odometry on '/odom'", odometry),
    ("odometry on '/odom'", odometry_without_speed),
    ("the IMU on '/imu'", imu),
    ("the clouds on '/points'", None),
]


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(("view", "tell"), EVIDENCE)
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_the_longest_standstill_is_found(
    tmp_path: Path, view: str, tell: Callable[..., Iterator[Raw]] | None, encoding: str
) -> None:
    store = ros2_types() if encoding == "cdr" else ros1_types()
    serialise = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
    messages = list(clouds(store, serialise, real=tell is None))
    if tell is not None:
        messages += tell(store, serialise)
    messages.sort(key=lambda message: message[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", encoding=encoding, messages=messages, chunk_size=20_000)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto", frames=5))
    times_s = [(scan.stamp_ns - START_NS) / 1e9 for scan in snapshot["roof"].scans]
    first_s, last_s = STILL_S[1]
    assert len(times_s) == 5
    assert first_s <= times_s[0] < first_s + 1.5
    assert last_s - 3.0 < times_s[-1] < last_s
    (note,) = snapshot.notes
    assert note.startswith("The vehicle stands still from ")
    assert f" by {view}; frames are from there." in note


def test_an_imu_may_measure_in_g_or_without_gravity(tmp_path: Path) -> None:
    store, tell = ros2_types(), partial(imu, shake_mps2=0.25)
    found = []
    for kind in ({}, {"unit_mps2": 9.81}, {"gravity_mps2": 0.0}):
        told = tell(store, store.serialize_cdr, **kind)
        messages = sorted([*clouds(store, store.serialize_cdr, real=False), *told], key=lambda message: message[2])
        write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages, chunk_size=20_000)
        with closing(open_source(find_source([locate(tmp_path / "a.mcap")]))) as recording:
            found.append(find_standstills(recording, cloud_span(recording)).spans)
    assert found[0] == found[1] == found[2]
    assert len(found[0]) == len(STILL_S)


@pytest.mark.slow
@pytest.mark.parametrize(("speed_mps", "rest_mps"), [(0.0, 0.0), (2.0, 0.06)])
def test_odometry_that_is_dead_or_noisy_leaves_it_to_clouds(tmp_path: Path, speed_mps: float, rest_mps: float) -> None:
    store = ros2_types()
    told = odometry(store, store.serialize_cdr, speed_mps=speed_mps, rest_mps=rest_mps)
    messages = sorted([*clouds(store, store.serialize_cdr, real=True), *told], key=lambda message: message[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages, chunk_size=20_000)
    with closing(open_source(find_source([locate(tmp_path / "a.mcap")]))) as recording:
        found = find_standstills(recording, cloud_span(recording))
    assert found.evidence == "the clouds on '/points'"
    assert len(found.spans) == len(STILL_S)


@pytest.mark.slow
@pytest.mark.parametrize("tell", [odometry, imu])
def test_evidence_of_a_part_leaves_the_whole_to_another(tmp_path: Path, tell: Callable[..., Iterator[Raw]]) -> None:
    """The node died while the vehicle stood."""
    store = ros2_types()
    told = [each for each in tell(store, store.serialize_cdr) if stamp_ns(3.2) < each[2] < stamp_ns(4.8)]
    real = (each for each in clouds(store, store.serialize_cdr, real=True) if each[2] > stamp_ns(3.1))
    messages = sorted([*real, *told], key=lambda message: message[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages, chunk_size=20_000)
    with closing(open_source(find_source([locate(tmp_path / "a.mcap")]))) as recording:
        found = find_standstills(recording, cloud_span(recording))
    assert found.evidence == "the clouds on '/points'"
    assert not found.is_whole
    assert len(found.spans) == len(STILL_S)


def test_others_help_a_lidar_that_shows_nothing_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of three LiDARs sees too little at some of the times."""
    seconds, late_ns = range(6), 60_000_000
    seen = {
        "rear": [None, None, True, True, False, True],
        "left": [True, None, None, None, None, False],
        "right": [True, True, None, None, None, True],
    }
    samples = {
        topic: [(10**9 * at + late_ns * number, still) for at, still in zip(seconds, own, strict=True)]
        for number, (topic, own) in enumerate(seen.items())
    }
    times_ns = [10**9 * at for at in seconds]
    monkeypatch.setattr(standstill, "richest_topics", lambda *_: [*seen])
    monkeypatch.setattr(standstill, "_cloud_samples", lambda _, topic, *__: (samples[topic], times_ns))
    evidence, found, _ = standstill._by_clouds(None, (0, 5 * 10**9), standstill.untold)
    assert evidence == "the clouds on 'rear'"
    assert [at for at, _ in found] == [at for at, _ in samples["rear"]]
    assert [still for _, still in found] == [True, True, True, True, False, True]


def test_from_some_time_on(tmp_path: Path) -> None:
    store = ros2_types()
    messages = [*clouds(store, store.serialize_cdr, real=False), *odometry(store, store.serialize_cdr)]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=sorted(messages, key=lambda message: message[2]))
    config = IngestConfig(window="auto", start_s=15.0, frames=1)
    with pytest.raises(UnfitSnapshotError, match="the vehicle never stands still") as refusal:
        read_snapshot(tmp_path / "a.mcap", config=config.model_copy(update={"start_s": 16.5}))
    assert refusal.value.code == "moving_vehicle"
    with pytest.raises(UnfitSnapshotError, match="the vehicle never stands still"):
        read_snapshot(tmp_path / "a.mcap", config=config.model_copy(update={"start_s": 15.6}))
    snapshot = read_snapshot(tmp_path / "a.mcap", config=config.model_copy(update={"start_s": 13.0}))
    assert snapshot.notes[0].startswith("The vehicle stands still from 13.0 to 15.")


def test_a_vehicle_that_always_stands_gives_the_whole_recording(tmp_path: Path) -> None:
    store = ros1_types()
    messages = [*clouds(store, store.serialize_ros1, real=False), *odometry(store, store.serialize_ros1)]
    first_s, last_s = STILL_S[1]
    still = sorted((raw for raw in messages if stamp_ns(first_s) <= raw[2] < stamp_ns(last_s)), key=lambda raw: raw[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", encoding="ros1", messages=still)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto", frames=7))
    assert [round((scan.stamp_ns - START_NS) / 1e9) for scan in snapshot["roof"].scans] == [9, 10, 11, 12, 13, 14, 15]
    write_mcap(make_snapshot(frames=3), tmp_path / "short.mcap")
    with pytest.raises(UnfitSnapshotError, match="nothing shows when the vehicle stands still"):
        read_snapshot(tmp_path / "short.mcap", config=IngestConfig(window="auto"))


@pytest.mark.slow
def test_a_lidar_of_two_frames_a_second_tells(tmp_path: Path) -> None:
    store = ros2_types()
    messages = [
        ("/points", CLOUD, time_ns, bytes(store.serialize_cdr(cloud_message(store, scan, "roof"), CLOUD)))
        for number, time_s in enumerate(np.arange(10.0, 15.0, 0.5))
        for time_ns, scan in [(stamp_ns(time_s), room_scan(time_s, number))]
    ]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto", frames=3))
    assert snapshot.notes[0].startswith("The vehicle stands still from 0.0 to 4.5 s by the clouds on '/points'")


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_lidar_that_cannot_tell_leaves_it_to_another(tmp_path: Path) -> None:
    store = ros2_types()
    messages = list(clouds(store, store.serialize_cdr, real=True))
    for time_s in np.arange(0.05, DURATION_S, 0.2):
        rng = np.random.default_rng(round(time_s * 100))
        ground = Scan(
            np.column_stack([rng.uniform(-20.0, 20.0, (6000, 2)), rng.normal(-2.0, 0.01, 6000)]).astype(np.float32),
            stamp_ns(time_s),
            np.zeros(6000, np.float32),
        )
        message = cloud_message(store, ground, "floor")
        messages.append(("/floor", CLOUD, stamp_ns(time_s), bytes(store.serialize_cdr(message, CLOUD))))
    messages.sort(key=lambda message: message[2])
    assert len(messages[1][3]) > len(messages[0][3])
    path, config = tmp_path / "a.mcap", IngestConfig(window="auto", frames=5)
    write_mcap(Snapshot(()), path, messages=messages, chunk_size=20_000)
    note = read_snapshot(path, config=config).notes[0]
    assert note.startswith("The vehicle stands still from 9.")
    assert note.endswith(" by the clouds on '/points'; frames are from there.")
    write_mcap(Snapshot(()), path, messages=[message for message in messages if message[0] == "/floor"])
    with pytest.raises(UnfitSnapshotError, match="the clouds on '/floor' show too little, as in a tunnel"):
        read_snapshot(path, config=config)


def test_a_recording_of_less_than_a_second_is_taken_whole(tmp_path: Path) -> None:
    store = ros2_types()
    messages = [*clouds(store, store.serialize_cdr, real=True), *odometry(store, store.serialize_cdr)]
    first_ns = stamp_ns(STILL_S[1][0])
    for kept in (messages, [raw for raw in messages if raw[0] != "/odom"]):
        short = sorted((raw for raw in kept if first_ns <= raw[2] < first_ns + 700_000_000), key=lambda raw: raw[2])
        write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=short)
        snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto", frames=3))
        (note,) = snapshot.notes
        assert note.startswith("The vehicle stands still from 0.0 to 0.6 s by the clouds")
        assert len(snapshot["roof"].scans) == 3


@pytest.mark.parametrize("indexed", [True, False])
def test_a_recording_of_one_frame_is_taken(indexed: bool, tmp_path: Path) -> None:
    snapshot = make_snapshot(lidars=3, frames=1)
    write_mcap(snapshot, tmp_path / "one.mcap", indexed=indexed)
    found = read_snapshot(tmp_path / "one.mcap", config=IngestConfig(window="auto"))
    assert {lidar.name: len(lidar.scans) for lidar in found.lidars} == dict.fromkeys(snapshot.names, 1)
    assert found.notes == ("There is one frame per LiDAR, so no standstill to choose.",)


def test_odd_messages_are_no_evidence(tmp_path: Path) -> None:
    store = ros2_types()
    messages = [*clouds(store, store.serialize_cdr, real=False), *odometry(store, store.serialize_cdr)]
    cut = [(topic, kind, time_ns, data[:30] if topic == "/odom" else data) for topic, kind, time_ns, data in messages]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=sorted(cut, key=lambda message: message[2]))
    with pytest.raises(UnfitSnapshotError, match="there is no readable odometry or IMU"):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto"))


@pytest.mark.slow
def test_a_lidar_that_falls_silent_leaves_the_rest_to_another(tmp_path: Path) -> None:
    """The one with the larger clouds would tell of one standstill, before the vehicle drives off."""
    store = ros2_types()
    messages = list(clouds(store, store.serialize_cdr, real=True))
    for number, time_s in enumerate(np.arange(3.05, 5.0, 0.2)):
        scan = room_scan(time_s, number)
        larger = Scan(np.tile(scan.points_m, (2, 1)), scan.stamp_ns, np.tile(scan.intensity, 2))
        message = bytes(store.serialize_cdr(cloud_message(store, larger, "silent"), CLOUD))
        messages.append(("/silent", CLOUD, stamp_ns(time_s), message))
    messages = sorted((each for each in messages if each[2] >= stamp_ns(3.0)), key=lambda message: message[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages, chunk_size=20_000)
    with closing(open_source(find_source([locate(tmp_path / "a.mcap")]))) as recording:
        span = cloud_span(recording)
        found = find_standstills(recording, span)
        assert richest_topics(recording, span) == ["/silent", "/points"]
    assert found.evidence == "the clouds on '/points'"
    assert len(found.spans) == 2


def test_the_last_frame_of_a_standstill_counts(tmp_path: Path) -> None:
    store = ros1_types()
    messages = [*clouds(store, store.serialize_ros1, real=False), *odometry(store, store.serialize_ros1)]
    still = sorted((raw for raw in messages if stamp_ns(9.0) <= raw[2] <= stamp_ns(9.8)), key=lambda raw: raw[2])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", encoding="ros1", messages=still)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window="auto", frames=10))
    assert len(snapshot["roof"].scans) == sum(topic == "/points" for topic, *_ in still)
