# SPDX-License-Identifier: Apache-2.0
"""Advice to the driver of a vehicle whose stops are recorded, by a simulated drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UsageError
from multilica.ingest import TakenSnapshot, read_drive
from multilica.ingest.drive_recorder import join_stops, record_stops, take_stops
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import window_metadata, write_snapshot_mcap
from multilica.snapshot import LidarScans, Snapshot
from tests.ingest.support.drive_logs import small_rig

pytestmark = pytest.mark.slow

FRAMES, ON_WAY = 3, slice(16, 19)


@pytest.fixture(scope="module")
def drive() -> Iterator[SimulatedDrive]:
    """Two stops of a vehicle with two small LiDARs, and the way between them."""
    with small_rig():
        yield simulate_drive("small", "yard", 4, stops=2, frames=FRAMES, sensors="ideal", with_log=True)


@pytest.fixture
def moving(drive: SimulatedDrive) -> Snapshot:
    return Snapshot(tuple(replace(lidar, scans=lidar.scans[ON_WAY]) for lidar in drive.log.lidars))


def late(snapshot: Snapshot, name: str) -> Snapshot:
    """The snapshot with frames of one LiDAR that begin after those of the others have ended."""
    later = (replace(scan, stamp_ns=scan.stamp_ns + 10**9) for scan in snapshot[name].scans)
    moved = replace(snapshot[name], scans=tuple(later))
    return replace(snapshot, lidars=tuple(moved if each.name == name else each for each in snapshot.lidars))


def looks_at(*seen: Snapshot | TakenSnapshot | Exception) -> Callable[[], TakenSnapshot]:
    """A vehicle that is seen so, one look after the other."""
    left = iter(seen)

    def look() -> TakenSnapshot:
        found = next(left)
        if isinstance(found, Exception):
            raise found
        return found if isinstance(found, TakenSnapshot) else TakenSnapshot(found)

    return look


def recorded(look: Callable[[], TakenSnapshot], wanted: int = 2) -> tuple[list[tuple[int, str]], list[int]]:
    """What the driver is told, with the good stops so far, and how many stops were kept each time."""
    told: list[tuple[int, str]] = []
    kept: list[int] = []
    seconds = count(0.0, 5.0)
    record_stops(
        look,
        wanted,
        lambda stops: kept.append(len(stops)),
        lambda advice: told.append((advice.recorded, advice.text)),
        clock=lambda: next(seconds),
        sleep=lambda _: None,
    )
    return told, kept


def test_the_driver_is_told_when_to_move_on(drive: SimulatedDrive, moving: Snapshot) -> None:
    first, second = drive.snapshots
    silent = TakenSnapshot(second, silent=("/lidar/rear/points",))
    told, kept = recorded(looks_at(moving, first, first, moving, silent, second))
    on = "drive on by 2 m or more, and turn by 60 degrees or more"
    assert told[:3] == [
        (0, "The vehicle moves: stop for a moment."),
        (1, f"Stop 1 of 2 is good: 2 LiDARs, 3 scans each. Now {on}."),
        (1, f"The vehicle stands at stop 1, after a turn of about 0 degrees: {on}."),
    ]
    assert told[3][0] == 1
    assert told[3][1].startswith("The vehicle moves, after a turn of about ")
    assert told[4:] == [
        (1, "The vehicle stands, but there is no scan of /lidar/rear/points. Wait, or leave that out with --topic."),
        (2, "Stop 2 of 2 is good: 2 LiDARs, 3 scans each. That was the last one."),
    ]
    assert kept == [1, 2]


def test_a_turn_is_measured_on_the_way(drive: SimulatedDrive, moving: Snapshot) -> None:
    told, _ = recorded(looks_at(drive.snapshots[0], *[moving] * 4, drive.snapshots[1]))
    turns_deg = [int(text.split()[8]) for _, text in told[1:-1]]
    assert turns_deg == sorted(turns_deg)
    assert turns_deg[-1] >= 60  # over 20 s
    assert "which is enough" in told[-2][1]


def test_a_failure_on_the_way_is_told(drive: SimulatedDrive) -> None:
    lost = UnfitSnapshotError("nothing came")
    told, kept = recorded(looks_at(drive.snapshots[0], lost, drive.snapshots[1]))
    assert told[1] == (1, "nothing came")
    assert kept == [1, 2]
    with pytest.raises(UnfitSnapshotError, match="nothing came"):
        recorded(looks_at(lost, *drive.snapshots))


def test_stops_are_joined_by_lidar(drive: SimulatedDrive) -> None:
    first, second = drive.snapshots
    less = replace(second, lidars=second.lidars[:1], notes=("one is missing",))
    joined, spans = join_stops([first, less])
    assert [(lidar.name, len(lidar.scans)) for lidar in joined.lidars] == [("front", 6), ("rear", 3)]
    assert joined.notes == (*first.notes, "one is missing")
    assert first.source.endswith(", stop 1")
    assert joined.source == first.source.removesuffix(", stop 1")
    assert spans[0] == drive.spans_ns[0]
    assert spans[0][1] < spans[1][0]


@pytest.mark.parametrize("stamped", [True, False])
def test_stops_whose_times_overlap_are_told_apart(drive: SimulatedDrive, tmp_path: Path, stamped: bool) -> None:
    """Stops of two logs whose clocks begin alike, and of point files without times."""
    first, other = drive.snapshots
    second = replace(
        other, lidars=tuple(_with_times_of(*each) for each in zip(other.lidars, first.lidars, strict=True))
    )
    given = [first, second] if stamped else [_without_times(each) for each in (first, second)]
    joined, spans = join_stops(given)
    assert spans[0][1] < spans[1][0]
    path, config = tmp_path / "drive.mcap", IngestConfig(frames=FRAMES)
    write_snapshot_mcap(joined, path, metadata=window_metadata(config, "", spans))
    for stop, source in zip(read_drive(path, "auto", config=config), given, strict=True):
        for lidar, expected in zip(stop.lidars, source.lidars, strict=True):
            for scan, of_source in zip(lidar.scans, expected.scans, strict=True):
                np.testing.assert_array_equal(scan.points_m, of_source.points_m)
                assert scan.stamp_ns == of_source.stamp_ns or not stamped


def _with_times_of(lidar: LidarScans, other: LidarScans) -> LidarScans:
    times_ns = [(scan.stamp_ns, scan.log_time_ns) for scan in other.scans]
    pairs = zip(lidar.scans, times_ns, strict=True)
    return replace(lidar, scans=tuple(replace(scan, stamp_ns=one, log_time_ns=two) for scan, (one, two) in pairs))


def _without_times(stop: Snapshot) -> Snapshot:
    bare = (tuple(replace(scan, stamp_ns=0, log_time_ns=0) for scan in lidar.scans) for lidar in stop.lidars)
    lidars = tuple(replace(lidar, scans=scans) for lidar, scans in zip(stop.lidars, bare, strict=True))
    return replace(stop, lidars=lidars)


def test_no_frame_is_lost_where_a_lidar_begins_late(drive: SimulatedDrive, tmp_path: Path) -> None:
    joined, spans = join_stops([late(drive.snapshots[0], "rear"), late(drive.snapshots[1], "front")])
    config = IngestConfig(frames=FRAMES)
    write_snapshot_mcap(joined, tmp_path / "drive.mcap", metadata=window_metadata(config, "", spans))
    stops = read_drive(tmp_path / "drive.mcap", "auto", config=config)
    assert [[len(lidar.scans) for lidar in stop.lidars] for stop in stops] == [[FRAMES] * 2] * 2


def test_one_frame_does_not_tell_whether_it_stands() -> None:
    with pytest.raises(UsageError, match="expected two or more"):
        take_stops(["ws://127.0.0.1:9"], 2, pytest.fail, pytest.fail, config=IngestConfig(frames=1))
