# SPDX-License-Identifier: Apache-2.0
"""Calibrations of snapshots in which something moves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from multilica import calibrate, events
from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.errors import UnfitSnapshotError
from multilica.results import PreprocessedCloud
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot

pytestmark = pytest.mark.slow


@cache
def _snapshot(*disturbances: str) -> Snapshot:
    return simulate_snapshot("sides", "street", 7, frames=4, disturbances=disturbances).snapshot


def _clouds(snapshot: Snapshot, config: CalibrationConfig) -> list[PreprocessedCloud]:
    seen: list[events.Event] = []
    calibrate(snapshot, with_overrides(config, ["until=preprocess"]), seen.append)
    return [event.cloud for event in seen if isinstance(event, events.CloudPreprocessed)]


def _dropped(cloud: PreprocessedCloud) -> int:
    return len(cloud.dropped_m.get("moving", ()))


def _as_rows(points_m: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> set[bytes]:
    return {row.tobytes() for row in points_m.astype(np.float32)}


def test_a_moving_vehicle_is_refused_with_its_motion() -> None:
    with pytest.raises(UnfitSnapshotError, match=r"vehicle moves.*left by 0\.9\d m.*3 of 3.*--start"):
        calibrate(_snapshot("moving"))


def test_a_refusal_is_a_result_that_observers_get() -> None:
    seen: list[events.Event] = []
    with pytest.raises(UnfitSnapshotError) as raised:
        calibrate(_snapshot("moving"), None, seen.append)
    last = seen[-1]
    assert isinstance(last, events.CalibrationFinished)
    assert last.result.refusal is not None
    assert (last.result.refusal.code, last.result.refusal.text) == ("moving_vehicle", str(raised.value))
    assert last.result.status == "failed"
    assert not any(place.placed for place in last.result.placements)


def test_dead_and_dirty_sensors_are_in_the_result() -> None:
    snapshot = _snapshot("dead:left", "dirty:right")
    result = calibrate(snapshot, with_overrides(CalibrationConfig(), ["until=preprocess"]))
    found = {health.lidar: [reason.code for reason in health.reasons] for health in result.health}
    assert found == {"left": ["dead"], "right": ["dirty"], "top": []}


@pytest.mark.parametrize("disturbances", [(), ("pedestrians",)])
@pytest.mark.in_turn
def test_a_standing_vehicle_is_not_refused(disturbances: tuple[str, ...]) -> None:
    assert len(_clouds(_snapshot(*disturbances), CalibrationConfig())) == 3


def test_a_standing_scene_is_kept() -> None:
    snapshot = _snapshot()
    dropped = {cloud.lidar: _dropped(cloud) for cloud in _clouds(snapshot, CalibrationConfig())}
    assert all(count < 0.01 * snapshot[name].points_count for name, count in dropped.items())


@pytest.mark.in_turn
def test_most_of_the_pedestrians_are_dropped() -> None:
    standing, walked = _snapshot(), _snapshot("pedestrians")
    walking, found = 0, 0
    for cloud in _clouds(walked, CalibrationConfig()):
        people = _as_rows(walked[cloud.lidar].points_m) - _as_rows(standing[cloud.lidar].points_m)
        walking += len(people)
        found += len(people & _as_rows(cloud.dropped_m["moving"]))
    assert walking > 1000
    assert found > 0.5 * walking


def test_the_paper_accumulates_whatever_moves() -> None:
    assert [_dropped(cloud) for cloud in _clouds(_snapshot("moving"), preset("paper"))] == [0, 0, 0]
