# SPDX-License-Identifier: Apache-2.0
"""The loop of `multilica watch`, with a vehicle and a clock that are made up."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import psutil
import pytest

from multilica import read_snapshot
from multilica.checks import RigTolerances, Tolerance, read_reference, verify_snapshot
from multilica.config import CalibrationConfig, IngestConfig
from multilica.errors import MissingDependencyError, UnfitSnapshotError, UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.ingest import TakenSnapshot
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.watch import Observation, WatchRequest, watch_vehicle
from multilica.watch.loop import observe_vehicle
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import write_thinned_sample
from tests.selection import NIGHTLY

KNOCK = RigidTransform.from_xyz_rpy("left", "left", (0.0, 0.06, 0.0), (0.0, 0.0, 0.01))
INTERVAL_S = 60.0


class EndError(Exception):
    """The end of a made-up watch."""


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Snapshot:
    """One scan of each LiDAR of the embedded sample, with few points."""
    snapshot = read_snapshot(write_thinned_sample(tmp_path_factory.mktemp("log") / "log.mcap", 4))
    return Snapshot(tuple(first_scans(lidar) for lidar in snapshot.lidars), source="ros2://")


def first_scans(lidar: LidarScans) -> LidarScans:
    return LidarScans(lidar.name, lidar.scans[:1], lidar.frame_id, lidar.topic)


def moved(snapshot: Snapshot, name: str, motion: RigidTransform) -> Snapshot:
    """The same with a LiDAR that was knocked."""
    lidars = [replace(each, scans=shifted(each, motion)) if each.name == name else each for each in snapshot.lidars]
    return replace(snapshot, lidars=tuple(lidars))


def shifted(lidar: LidarScans, motion: RigidTransform) -> tuple[Scan, ...]:
    return tuple(replace(scan, points_m=motion.apply(scan.points_m).astype(np.float32)) for scan in lidar.scans)


def request(look: Callable[[], TakenSnapshot], interval_s: float = INTERVAL_S) -> WatchRequest:
    truth = find_sample().truth
    return WatchRequest(look, truth, RigTolerances(), CalibrationConfig(), interval_s)


def watched(looks: Sequence[Snapshot | Exception], took_s: float = 0.5) -> tuple[list[Observation], list[float]]:
    """What a watch tells of each look, and the pauses between them."""
    left, now_s = list(looks), [0.0]
    told: list[Observation] = []
    pauses: list[float] = []

    def look() -> TakenSnapshot:
        now_s[0] += took_s
        if isinstance(left[0], Snapshot):
            return TakenSnapshot(left.pop(0))
        raise left.pop(0)

    def sleep(pause_s: float) -> None:
        now_s[0] += pause_s
        pauses.append(pause_s)
        if not left:
            raise EndError

    with pytest.raises(EndError):
        watch_vehicle(request(look), told.append, clock=lambda: now_s[0], sleep=sleep)
    return told, pauses


@pytest.mark.slow
def test_a_knock_is_told_whatever_came_before(standing: Snapshot) -> None:
    moving = UnfitSnapshotError("The vehicle moves: left by 0.30 m.", code="moving_vehicle")
    looks = [standing, moving, UnreadableSourceError("Nothing answers."), ValueError("nonsense")]
    looks += [Snapshot(standing.lidars[:1]), moved(standing, "left", KNOCK)]
    told, pauses = watched(looks)
    outcomes = [each.outcome for each in told]
    assert outcomes == ["within", "moving", "failed", "failed", "failed", "outside"]
    assert pauses == [INTERVAL_S - 0.5, 1.0, 1.0, 1.0, 1.0, INTERVAL_S - 0.5]
    assert told[3].text == "This is a bug in multilica, not in the vehicle (ValueError: nonsense)."
    assert told[-1].check.moved == ("left",)
    assert "left" in told[-1].text
    assert told[-1].time_ns == max(lidar.scans[-1].log_time_ns or lidar.scans[-1].stamp_ns for lidar in standing.lidars)


@pytest.mark.in_turn
def test_a_verdict_is_that_of_verify(standing: Snapshot) -> None:
    (told,), _ = watched([standing])
    known = read_reference(find_sample().truth, {name: name for name in standing.names})
    assert told.check == verify_snapshot(standing, known, RigTolerances())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topics", "silent", "outcome"),
    [((), (), "undecided"), (("/lidar/*",), ("/lidar/right",), "undecided"), (("/lidar/[fl]*",), (), "within")],
    ids=["no topic", "silent topic", "left out"],
)
def test_a_lidar_that_sends_nothing_is_undecided(
    standing: Snapshot, topics: tuple[str, ...], silent: tuple[str, ...], outcome: str
) -> None:
    """A tolerance of its own is no mistake."""
    left, lost = Snapshot(standing.lidars[:-1], source="ros2://"), standing.names[-1]
    asked = replace(
        request(lambda: TakenSnapshot(left, silent=silent)),
        tolerances=RigTolerances(lidars={lost: Tolerance()}),
        config=CalibrationConfig(ingest=IngestConfig(only=topics)),
    )
    told = observe_vehicle(asked)
    assert told.outcome == outcome
    if outcome == "within":
        return
    assert f"{lost}: nothing to compare: no scan of that LiDAR was read." in told.text
    assert [each.lidar for each in told.check.lidars if each.verdict == "undecided"] == [lost]


def test_a_look_longer_than_the_interval_is_followed_by_a_pause(standing: Snapshot) -> None:
    _, pauses = watched([standing], took_s=2.0 * INTERVAL_S)
    assert pauses == [1.0]


def test_a_missing_library_ends_it_at_once() -> None:
    def look() -> TakenSnapshot:
        raise MissingDependencyError("needs the library rclpy")

    with pytest.raises(MissingDependencyError):
        watch_vehicle(request(look), pytest.fail)


def day(standing: Snapshot) -> Iterator[Snapshot | Exception]:
    """Standstills, drives, a bridge that is gone, and nonsense, over and over again."""
    drive = UnfitSnapshotError("The vehicle moves.", code="moving_vehicle")
    yield from cycle(
        [standing, drive, moved(standing, "left", KNOCK), UnreadableSourceError("gone"), ValueError("odd")]
    )


@pytest.mark.nightly
def test_a_day_keeps_memory_flat(standing: Snapshot) -> None:
    """24 hours of a made-up clock, a verdict every three minutes; without MULTILICA_NIGHTLY, one hour."""
    hours = 24.0 if NIGHTLY else 1.0
    looks, now_s, sizes = day(standing), [0.0], []

    def look() -> TakenSnapshot:
        found = next(looks)
        if isinstance(found, Snapshot):
            return TakenSnapshot(found)
        raise found

    def sleep(pause_s: float) -> None:
        now_s[0] += pause_s
        gc.collect()
        sizes.append(psutil.Process().memory_info().rss)
        if now_s[0] > hours * 3600.0:
            raise EndError

    told: list[str] = []
    with pytest.raises(EndError):
        watch_vehicle(request(look, 180.0), lambda each: told.append(each.outcome), clock=lambda: now_s[0], sleep=sleep)
    assert told.count("within") == pytest.approx(10 * hours, abs=1)
    settled = len(sizes) // 4
    assert max(sizes[settled:]) - sizes[settled] < 20_000_000


def test_the_calibration_is_read_at_each_look(standing: Snapshot, tmp_path: Path) -> None:
    told: list[Observation] = []
    missing = WatchRequest(
        lambda: TakenSnapshot(standing), tmp_path / "a.toml", RigTolerances(), CalibrationConfig(), INTERVAL_S
    )

    def sleep(_: float) -> None:
        if len(told) == 2:
            raise EndError
        (tmp_path / "a.toml").write_bytes(find_sample().truth.read_bytes())

    with pytest.raises(EndError):
        watch_vehicle(missing, told.append, sleep=sleep)
    assert [each.outcome for each in told] == ["failed", "within"]
