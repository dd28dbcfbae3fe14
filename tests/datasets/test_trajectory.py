# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.datasets.helipr import Trajectory, stops_by_poses, stops_by_scans
from multilica.simulate import simulate_snapshot

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000_123_456_789


def path(xyz_m: list[float], yaws_deg: list[float], step_ns: int = SECOND_NS // 10) -> Trajectory:
    stamps_ns = START_NS + step_ns * np.arange(len(xyz_m), dtype=np.int64)
    positions_m = np.stack([xyz_m, np.zeros(len(xyz_m)), np.ones(len(xyz_m))], axis=1)
    return Trajectory(
        "roof", stamps_ns, positions_m, Rotation.from_euler("z", np.array(yaws_deg)[:, None], degrees=True)
    )


def test_poses_are_interpolated_to_the_nanosecond() -> None:
    found = path([0.0, 1.0, 4.0], [0.0, 0.0, 30.0], SECOND_NS).pose_at(START_NS + SECOND_NS + SECOND_NS // 4)
    assert found is not None
    np.testing.assert_allclose(found.xyz_m, [1.75, 0.0, 1.0], atol=1e-9)
    assert math.degrees(found.rpy_rad[2]) == pytest.approx(7.5, abs=1e-9)
    assert (found.target, found.source) == ("world", "roof")


@pytest.mark.parametrize(("offset_ns", "x_m"), [(-1, None), (0, 0.0), (SECOND_NS, 1.0), (2 * SECOND_NS + 1, None)])
def test_there_is_no_pose_outside(offset_ns: int, x_m: float | None) -> None:
    found = path([0.0, 1.0, 4.0], [0.0, 0.0, 0.0], SECOND_NS).pose_at(START_NS + offset_ns)
    assert (None if found is None else found.xyz_m[0]) == x_m


def test_a_stop_lasts_as_long_as_asked() -> None:
    ways_m = [0.0] * 5 + [0.2 * index for index in range(1, 6)] + [1.0] * 10 + [1.2, 1.4, 1.6]
    driven = path(ways_m, [0.0] * len(ways_m))
    stops = stops_by_poses(driven, 3 * SECOND_NS // 10)
    # Windows begin at poses 0 and 1, and at 9 to 16: of each stop, the one in the middle.
    assert stops == [START_NS + 12 * SECOND_NS // 10, START_NS]
    assert stops_by_poses(driven, 8 * SECOND_NS // 10) == [START_NS + SECOND_NS]
    assert stops_by_poses(driven, 2 * SECOND_NS) == []


@pytest.mark.parametrize(("turn_deg", "stops"), [(0.05, 1), (0.2, 0)])
def test_turning_on_the_spot_is_no_stop(turn_deg: float, stops: int) -> None:
    turned = path([0.0] * 10, [turn_deg * index for index in range(10)])
    assert len(stops_by_poses(turned, 3 * SECOND_NS // 10)) == stops


def test_creeping_counts_over_the_whole_window() -> None:
    crept = path([0.02 * index for index in range(10)], [0.0] * 10)
    assert len(stops_by_poses(crept, 2 * SECOND_NS // 10)) == 1
    assert stops_by_poses(crept, 3 * SECOND_NS // 10) == []


def test_a_gap_is_no_stop() -> None:
    whole = path([0.0] * 4 + [9.0] * 4, [0.0] * 8)
    later_ns = whole.stamps_ns + np.where(np.arange(8) > 3, 5 * SECOND_NS, 0)
    gap = Trajectory("roof", later_ns, whole.xyz_m, whole.rotations)
    assert stops_by_poses(gap, 3 * SECOND_NS // 10) == [int(later_ns[1]), int(later_ns[4])]


@pytest.mark.slow
@pytest.mark.in_turn
def test_scans_tell_standing_from_driving() -> None:
    """At rest for 9 s, then driving: a look every two seconds finds the middle of the first part."""
    parts = [
        simulate_snapshot("helipr", "street", 3, frames=4, disturbances=each, sensors="ideal")
        for each in ((), ("moving",))
    ]
    rest, drive = (part.snapshot["velodyne"].scans for part in parts)
    looks = [(2 * SECOND_NS * index, rest if index < 5 else drive) for index in range(8)]
    scans = {START_NS + at_ns + index * SECOND_NS // 10: scans[index] for at_ns, scans in looks for index in range(4)}
    stamps_ns = np.array(sorted(scans), np.int64)
    stops = stops_by_scans(stamps_ns, lambda wanted: [scans[each] for each in wanted], 3 * SECOND_NS // 10)
    assert stops == [START_NS + 4 * SECOND_NS]
