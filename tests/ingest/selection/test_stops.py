# SPDX-License-Identifier: Apache-2.0
"""The standstills of a log that are chosen as stops, by simulated drives whose stops are known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import multilica
from multilica import events
from multilica.config import CalibrationConfig, IngestConfig, preset, with_overrides
from multilica.drive_calibration import wanted_stops
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.geometry import RigidTransform
from multilica.ingest import (
    Stop,
    drive_reader,
    find_stops,
    inspect_source,
    read_drive,
    read_log,
    read_snapshot,
    read_stops,
    stops_of_log,
    ways,
)
from multilica.ingest import stops as stops_module
from multilica.ingest.locate import find_source
from multilica.ingest.memory import MemoryLimitError
from multilica.ingest.opening import open_source
from multilica.ingest.recording import DamagedRecordingError, Messages, Recording, Span, Topic
from multilica.ingest.selection import standstill
from multilica.run import run_calibration
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import write_ros1_bag, write_ros2_bag, write_ros2_mcap
from multilica.snapshot import LidarScans, Snapshot
from tests.ingest.support.drive_logs import small_rig
from tests.ingest.support.processes import served

pytestmark = pytest.mark.slow

STAND_FRAMES = 25
SLOW_NS = 200_000_000
"""In which the vehicle goes millimetres when it sets out or arrives."""
FEW = IngestConfig(frames=3)


@pytest.fixture(scope="module", autouse=True)
def _small_rig() -> Iterator[None]:
    """Two LiDARs of a few thousand beams."""
    with small_rig():
        yield


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    """Three stops in a yard, a half turn in all."""
    options = {"stops": 3, "frames": STAND_FRAMES, "sensors": "ideal", "with_log": True}
    return simulate_drive("small", "yard", 4, route="turning", **options)


@pytest.fixture(scope="module")
def log(drive: SimulatedDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its log, which no test changes."""
    path = tmp_path_factory.mktemp("log") / "drive.mcap"
    write_ros2_mcap(drive.log, path)
    return path


@pytest.mark.in_turn
def test_the_stops_of_a_log_are_calibrated_as_one_drive(drive: SimulatedDrive, log: Path, tmp_path: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["ingest.frames=3", "runtime.workers=1"])
    run = run_calibration(log, tmp_path / "run", config)
    assert [each.name for each in run.result.snapshots] == ["stop_1", "stop_2", "stop_3"]
    assert {each.lidar for each in run.result.motions} == {"front", "rear"}
    assert {path.name for path in run.written} > {"result.json", "stop_1", "stop_2", "stop_3"}
    for each in run.result.placements:
        if each.placed and each.lidar != run.result.target:
            truth = drive.truth.between(run.result.target, each.lidar)
            assert each.T_target_source.distance_to(truth)[0] < 0.05


@pytest.mark.in_turn
def test_the_motion_from_stop_to_stop_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the times of points as ROS 2 has them, which snapshots leave out."""
    options = {"stops": 2, "frames": STAND_FRAMES, "sensors": "ideal", "with_log": True}
    straight = simulate_drive("small", "yard", 4, route="straight", **options)
    write_ros2_mcap(straight.log, tmp_path / "drive.mcap")
    first, second = read_drive(tmp_path / "drive.mcap", 2, config=FEW)
    assert first.read_motions is None
    motions = second.read_motions()
    assert [motion.lidar for motion in motions] == ["front", "rear"]
    rear = motions[1]  # the front LiDAR has hardly anything in sight
    mount = straight.truth.T_target_source["rear"].matrix
    truth = np.linalg.inv(mount) @ straight.T_first_stop_base[1].matrix @ mount
    error = rear.T_before_now.offset_from(RigidTransform("rear", "rear", truth))
    assert np.linalg.norm(error[3:]) < 0.01 * rear.way_m
    assert rear.frames < STAND_FRAMES + 12
    monkeypatch.setattr(ways, "LONGEST_WAY_S", 1.0)
    assert not second.read_motions()


@pytest.mark.in_turn
def test_the_library_takes_the_stops_of_a_log(log: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["ingest.frames=3", "runtime.workers=1"])
    assert len(multilica.calibrate(log, config, stops=2).snapshots) == 2


def test_a_log_with_one_standstill_is_read_there(drive: SimulatedDrive, tmp_path: Path) -> None:
    """The log begins while the vehicle drives; fewer stops than asked for are told."""
    path, stood = tmp_path / "late.mcap", STAND_FRAMES
    write_ros2_mcap(part(drive, slice(stood + 5, 2 * stood + 26)), path)
    (snapshot,) = read_drive(path, 3, config=FEW)
    assert drive.spans_ns[1][0] - SLOW_NS <= snapshot["front"].scans[0].stamp_ns <= drive.spans_ns[1][1]
    assert snapshot.notes[-1] == "3 stops of different place or heading were asked for, and 1 found."
    config = with_overrides(CalibrationConfig(), ["ingest.frames=3", "drive.stops=3", "runtime.workers=1"])
    told: list[events.RunEvent] = []
    run_calibration(path, tmp_path / "run", config, observe=told.append)
    assert {*snapshot.notes} <= {getattr(event, "note", "") for event in told}
    progress = [event for event in told if isinstance(event, events.StopsProgressed)]
    assert {event.doing for event in progress} == {"find stops", "read stops"}
    assert told[: len(progress)] == progress
    assert progress[-2].done == progress[-2].total > 1
    assert progress[-1] == events.StopsProgressed("read stops", 1, 1)


def test_a_target_that_no_stop_has_is_told_before_calibration(log: Path, tmp_path: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["ingest.frames=3", "target=nose"])
    with pytest.raises(UnknownNameError, match="nose"):
        run_calibration(log, tmp_path / "run", config)
    assert not (tmp_path / "run").exists()


def test_a_running_vehicle_has_no_stops(tmp_path: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["drive.stops=2"])
    with pytest.raises(UsageError, match="only a log has stops"):
        run_calibration("ros2://", tmp_path / "run", config)


def longer(lidar: LidarScans, frames: int) -> LidarScans:
    """Repeat the first frames of a LiDAR, a tenth of a second after each other."""
    first, *_ = lidar.scans
    scans = (
        replace(lidar.scans[number % STAND_FRAMES], stamp_ns=first.stamp_ns + number * 100_000_000)
        for number in range(frames)
    )
    return replace(lidar, scans=tuple(scans))


def assert_read_as_one(path: Path, config: IngestConfig = FEW) -> None:
    """Nothing tells that stops were looked for."""
    assert stops_of_log([path], "auto", config=config) == ()
    (found,), usual = read_drive(path, "auto", config=config), read_snapshot(path, config=config)
    assert (found.notes, found.source) == (usual.notes, usual.source)
    for one, other in zip(found.lidars, usual.lidars, strict=True):
        for scan, same in zip(one.scans, other.scans, strict=True):
            assert (scan.stamp_ns, scan.points_m.tobytes()) == (same.stamp_ns, same.points_m.tobytes())


def test_a_vehicle_that_stays_costs_a_look(
    drive: SimulatedDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, decoded = tmp_path / "a.mcap", list[int]()
    write_ros2_mcap(Snapshot(tuple(longer(lidar, 60) for lidar in drive.log.lidars)), path)
    decode = drive_reader.decode_cloud
    monkeypatch.setattr(drive_reader, "decode_cloud", lambda message: decoded.append(1) or decode(message))
    monkeypatch.setattr(drive_reader, "search_log", lambda *_: pytest.fail("a search"))
    assert_read_as_one(path)
    assert 1 < len(decoded) <= 10  # by `assert_read_as_one`, twice


def test_a_drive_with_one_standstill_is_read_as_one_and_told(drive: SimulatedDrive, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_ros2_mcap(part(drive, slice(0, STAND_FRAMES + 20)), path)
    (found,), usual = read_drive(path, "auto", config=FEW), read_snapshot(path, config=FEW)
    assert found.notes[:-1] == usual.notes
    assert found.notes[-1].startswith("The vehicle drives in this log, and fewer than two stops")
    assert [lidar.scans[0].stamp_ns for lidar in found.lidars] == [lidar.scans[0].stamp_ns for lidar in usual.lidars]


@pytest.mark.in_turn
@pytest.mark.parametrize("chosen", [{"start_s": 1.0}, {"window": "auto"}, {"window_s": 0.5}])
def test_chosen_frames_come_before_stops(log: Path, chosen: dict[str, object]) -> None:
    assert_read_as_one(log, FEW.model_copy(update=chosen))


def test_a_log_without_index_is_searched_only_on_demand(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-1000])
    assert_read_as_one(cut)
    assert len(stops_of_log([cut], 3, config=FEW)) == 3


def test_stops_that_take_too_much_memory_are_left_out(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = drive_reader.read_stops

    def read(stops: list[Stop], **options: object) -> tuple[Snapshot, ...]:
        if len(stops) > 1:
            raise MemoryLimitError("too much")
        return whole(stops, **options)

    monkeypatch.setattr(drive_reader, "read_stops", read)
    stops = stops_of_log([log], 3, config=FEW)
    (snapshot,) = read_log(stops, "auto", config=FEW)
    assert snapshot.notes[-2] == stops[0].why
    assert snapshot.notes[-1].startswith("1 of 3 stops are used")
    with pytest.raises(MemoryLimitError):
        read_log(stops, 3, config=FEW)


def test_what_gives_no_joint_result_has_no_stops() -> None:
    assert wanted_stops(CalibrationConfig()) == "auto"
    assert wanted_stops(preset("paper")) == wanted_stops(CalibrationConfig(until="coarse")) == 1
    assert wanted_stops(with_overrides(preset("paper"), ["drive.stops=3"])) == 3


def test_one_stop_is_the_single_snapshot(log: Path, tmp_path: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["ingest.frames=3", "until=features", "runtime.workers=1"])
    assert run_calibration(log, tmp_path / "run", config).result.snapshots == ()


def part(drive: SimulatedDrive, frames: slice) -> Snapshot:
    return Snapshot(tuple(replace(lidar, scans=lidar.scans[frames]) for lidar in drive.log.lidars))


@pytest.mark.parametrize(
    "write", [write_ros2_mcap, write_ros2_bag, pytest.param(write_ros1_bag, marks=pytest.mark.nightly)]
)
def test_all_stops_are_found(drive: SimulatedDrive, tmp_path: Path, write: Callable[[Snapshot, Path], None]) -> None:
    path = tmp_path / {"write_ros2_mcap": "a.mcap", "write_ros2_bag": "a", "write_ros1_bag": "a.bag"}[write.__name__]
    write(drive.log, path)
    stops = find_stops(path, config=FEW)
    assert len(stops) == 3
    for stop, (first_ns, last_ns) in zip(stops, drive.spans_ns, strict=True):
        assert first_ns - SLOW_NS <= stop.span_ns[0] < stop.span_ns[1] <= last_ns + SLOW_NS
        assert stop.end_s - stop.start_s >= 1.0
        assert "cells of 1 m" in stop.why
    snapshots = read_stops(stops, config=FEW)
    assert len({snapshot.source for snapshot in snapshots}) == 3
    for snapshot, stop in zip(snapshots, stops, strict=True):
        assert snapshot.names == ("front", "rear")
        stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans]
        assert len(stamps_ns) == 6
        assert stop.span_ns[0] <= min(stamps_ns) < max(stamps_ns) <= stop.span_ns[1]
        assert snapshot.notes[0].startswith("The vehicle stands still from")


@pytest.mark.nightly
def test_stops_of_a_log_on_a_server_are_the_same(log: Path) -> None:
    with served("file_server.py", log.parent) as port:
        stops = find_stops(f"http://127.0.0.1:{port}/files/{log.name}")
    assert [stop.span_ns for stop in stops] == [stop.span_ns for stop in find_stops(log)]


def test_few_of_the_scans_are_decoded(drive: SimulatedDrive, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most two a second of one LiDAR, and one of two LiDARs per standstill."""
    decoded: list[int] = []
    for module in (standstill, stops_module):
        decode = module.decode_cloud
        monkeypatch.setattr(module, "decode_cloud", lambda message, of=decode: decoded.append(1) or of(message))
    find_stops(log)
    duration_s = (drive.spans_ns[-1][1] - drive.spans_ns[0][0]) / 1e9
    assert 0 < len(decoded) <= 2 * (duration_s + 1) + 2 * 3
    assert len(decoded) < sum(len(lidar.scans) for lidar in drive.log.lidars) / 4


def test_as_many_stops_as_asked_for(log: Path) -> None:
    first, last = find_stops(log, most=2)
    assert first.end_s < last.start_s
    with pytest.raises(UsageError, match="expected one or more"):
        find_stops(log, most=0)


def test_stops_after_some_time(drive: SimulatedDrive, log: Path) -> None:
    """The longest of those is chosen if one is asked for."""
    after_s = (drive.spans_ns[0][1] - drive.spans_ns[0][0]) / 1e9 + 1.0
    (stop,) = find_stops(log, config=IngestConfig(start_s=after_s), most=1)
    assert stop.span_ns[0] >= drive.spans_ns[1][0] - SLOW_NS
    assert stop.why == "It is the longest standstill."


@pytest.mark.in_turn
def test_a_metre_further_is_no_new_stop(tmp_path: Path) -> None:
    options = {"stops": 2, "frames": STAND_FRAMES, "sensors": "ideal", "with_log": True}
    drive = simulate_drive("small", "yard", 4, route="straight", step_m=1.0, **options)
    write_ros2_mcap(drive.log, tmp_path / "a.mcap")
    assert len(inspect_source(tmp_path / "a.mcap").standstills) == 2
    assert len(find_stops(tmp_path / "a.mcap")) == 1


def test_a_log_that_stands_once_has_a_stop(drive: SimulatedDrive, tmp_path: Path) -> None:
    write_ros2_mcap(part(drive, slice(0, STAND_FRAMES + 20)), tmp_path / "a.mcap")
    (stop,) = find_stops(tmp_path / "a.mcap")
    assert (stop.start_s, stop.why) == (0.0, "It is the only standstill.")
    assert len(read_stops([stop], config=FEW)) == 1


def test_a_log_that_never_stands_has_none(drive: SimulatedDrive, tmp_path: Path) -> None:
    write_ros2_mcap(part(drive, slice(STAND_FRAMES + 6, STAND_FRAMES + 26)), tmp_path / "a.mcap")
    with pytest.raises(UnfitSnapshotError, match="the vehicle never stands still") as refusal:
        find_stops(tmp_path / "a.mcap")
    assert refusal.value.code == "moving_vehicle"
    assert inspect_source(tmp_path / "a.mcap").standstills == ()


def test_a_log_of_a_single_frame_is_a_stop(drive: SimulatedDrive, tmp_path: Path) -> None:
    write_ros2_mcap(part(drive, slice(3, 4)), tmp_path / "a.mcap")
    (stop,) = find_stops(tmp_path / "a.mcap")
    assert (stop.span_ns, stop.why) == (None, "There is one frame per LiDAR, so no standstill to choose.")
    (snapshot,) = read_stops([stop])
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [1, 1]
    assert inspect_source(tmp_path / "a.mcap").standstills == ()


def test_a_log_that_ends_too_early_has_the_stops_before(drive: SimulatedDrive, log: Path, tmp_path: Path) -> None:
    data, cut = log.read_bytes(), tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(0.75 * len(data))])
    stops = find_stops(cut, config=FEW)
    assert 1 <= len(stops) <= 2
    for stop, (first_ns, last_ns) in zip(stops, drive.spans_ns, strict=False):
        assert first_ns - SLOW_NS <= stop.span_ns[0] < stop.span_ns[1] <= last_ns + SLOW_NS
    assert len(read_stops(stops, config=FEW)) == len(stops)


def test_several_recordings_are_a_stop_each(drive: SimulatedDrive, tmp_path: Path) -> None:
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path, snapshot in zip(paths, drive.snapshots, strict=False):
        write_ros2_mcap(snapshot, path)
    stops = find_stops(paths)
    assert [stop.paths for stop in stops] == [(path,) for path in paths]
    assert [snapshot.source for snapshot in read_stops(stops, config=FEW)] == ["a.mcap", "b.mcap"]


def test_inspect_tells_the_standstills(drive: SimulatedDrive, log: Path) -> None:
    summary = inspect_source(log)
    begin_ns = drive.spans_ns[0][0]
    assert len(summary.standstills) == 3
    for found, (first_ns, last_ns) in zip(summary.standstills, drive.spans_ns, strict=True):
        assert (first_ns - begin_ns - SLOW_NS) / 1e9 <= found.start_s < (last_ns - begin_ns) / 1e9
        assert 1.0 <= found.length_s <= (last_ns - first_ns + 2 * SLOW_NS) / 1e9
    assert "the clouds on" in summary.standstill_evidence


class _BreaksOff(Recording):
    """A recording without index that cannot be read beyond a time."""

    is_indexed = False

    def __init__(self, whole: Recording, end_ns: int) -> None:
        self._whole, self._end_ns, self.topics = whole, end_ns, whole.topics

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        for message in self._whole.messages(topics, start_ns):
            if message.log_time_ns > self._end_ns:
                raise DamagedRecordingError("the log", "its records make no sense")
            yield message


def test_standstills_before_the_damage_are_found(drive: SimulatedDrive, log: Path) -> None:
    with closing(open_source(find_source(log))) as recording:
        broken = _BreaksOff(recording, drive.spans_ns[1][1])
        found = standstill.find_standstills(broken, (drive.spans_ns[0][0], drive.spans_ns[2][1]))
    assert len(found.spans) == 2


class _Clock(Recording):
    """A recording of an hour without messages."""

    topics = (Topic("/points", "sensor_msgs/msg/PointCloud2", "cdr", 36_000),)

    def messages(self, topics: object, start_ns: int = 0) -> Messages:
        del topics, start_ns
        yield from ()


def test_a_short_standstill_of_a_long_log_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples every 15 s meet it once; those about it tell its length."""
    asked: list[Span] = []

    def look(_: Recording, span: Span, __: object) -> tuple[str, list[tuple[int, bool | None]], int]:
        asked.append(span)
        times_ns = standstill._times_ns(span, 240, 0.25)
        still = [(time_ns, 1499e9 <= time_ns < 1503e9 or 2000e9 <= time_ns < 2060e9) for time_ns in times_ns]
        return "a clock", still, standstill._gap_ns(times_ns)

    monkeypatch.setattr(standstill, "_by_odometry", look)
    found = standstill.find_standstills(_Clock(), (0, 3600 * 10**9))
    assert len(found.spans) == 2
    first, second = found.spans
    assert 1499e9 <= first[0] < 1499.5e9
    assert 1502.5e9 < first[1] < 1503e9
    assert 2000e9 <= second[0] < second[1] < 2060e9
    assert len(asked) == 2
