# SPDX-License-Identifier: Apache-2.0
"""A stop that left a pair undecided excludes poses that other stops found."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.multi_snapshot import SnapshotRun, join
from multilica.multi_snapshot.pose_conflicts import excluded_poses
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.orchestration.stop_beams import lead_at
from multilica.orchestration.stop_views import DriveStop
from multilica.results import CalibrationResult, LidarPlacement, Verdict
from multilica.simulate import simulate_drive
from multilica.source_calibration import calibrate
from tests.unit.made_pairs import pair, pose, registration, undecided

_CONFIG = CalibrationConfig(target="front")
_MARGIN = _CONFIG.acceptance.min_log_odds_margin
_TRUTH = pose("front", "rear", (-3.0, 0.0, 0.0), np.pi)
_WRONG = pose("front", "rear", (5.0, 0.0, 0.0))
_ALONE = ("front", "rear")


def _run(name, trusted=(), open_poses=(), others=(), verdict=None):
    """A stop with accepted pairs, and one that was left undecided between poses."""
    pairs = [*trusted, *others]
    if open_poses:
        registrations = tuple(registration(each) for each in open_poses)
        pairs.append(pair(open_poses[0], verdict or undecided("ambiguous"), registrations=registrations))
    placements = tuple(LidarPlacement(lidar, "nothing in common") for lidar in _ALONE)
    result = CalibrationResult("front", "", placements, pairs=tuple(pairs), trusted=tuple(trusted))
    return SnapshotRun(name, result)


def _told(T_target_source):
    return replace(pair(T_target_source), information=np.diag([1e6] * 3 + [1e4] * 3))


def _excluded(runs, lead=_MARGIN):
    results = {run.name: run.result for run in runs}
    return excluded_poses({name: each.trusted for name, each in results.items()}, results, lambda *_: lead, _CONFIG)


_FOUND = _run("stop 1", [_told(_WRONG)])


def test_a_pose_that_an_undecided_stop_did_not_find_is_excluded():
    (found,) = _excluded([_FOUND, _run("stop 2", open_poses=[_TRUTH])])
    assert (found.snapshot, found.lidars, found.others) == ("stop 1", _ALONE, ("stop 2",))
    assert (found.distance_m, found.angle_deg, found.outvoted) == (pytest.approx(8.0), pytest.approx(180.0), True)


def test_the_direction_of_the_pairs_is_free():
    (found,) = _excluded([_FOUND, _run("stop 2", open_poses=[_TRUTH.inverse()])])
    assert found.distance_m == pytest.approx(8.0)
    assert not _excluded([_FOUND, _run("stop 2", open_poses=[_TRUTH.inverse(), _WRONG.inverse()])])


@pytest.mark.parametrize(
    "other",
    [
        _run("stop 2", open_poses=[_TRUTH, _WRONG]),
        _run("stop 2", open_poses=[_TRUTH], verdict=Verdict("reject")),
        _run("stop 2", [_told(pose("front", "top")), _told(pose("top", "rear"))], [_TRUTH]),
        _run("stop 2"),
    ],
    ids=["one of its poses", "rejected", "others tell it", "not searched"],
)
def test_no_other_stop_excludes_it(other):
    assert not _excluded([_FOUND, other])


def test_a_pose_that_fits_nearly_as_well_stays():
    assert not _excluded([_FOUND, _run("stop 2", open_poses=[_TRUTH])], lead=0.9 * _MARGIN)


def test_more_stops_with_the_same_pose_outvote_one():
    again = _run("stop 3", [_told(_WRONG.inverse())])
    runs = [_FOUND, again, _run("stop 2", open_poses=[_TRUTH])]
    assert not _excluded(runs)
    runs.append(_run("stop 4", open_poses=[_TRUTH]))
    assert [each.snapshot for each in _excluded(runs)] == ["stop 1", "stop 3"]


@pytest.mark.parametrize(("agreeing", "dropped"), [(1, True), (2, False)])
def test_a_pose_alone_among_excluded_ones_is_disputed(agreeing, dropped):
    """Two stops took the place for others, so that one with a third pose may have done so, too."""
    elsewhere = pose("front", "rear", (0.0, 7.0, 0.0))
    runs = [_FOUND, _run("stop 2", [_told(elsewhere)]), _run("stop 3", open_poses=[_TRUTH])]
    third = pose("front", "rear", (2.0, 2.0, 0.0), 1.0)
    runs += [_run(f"stop {4 + number}", [_told(third)]) for number in range(agreeing)]
    results = {run.name: run.result for run in runs}

    def lead(_, __, there):
        return 0.0 if there.distance_to(third)[0] < 0.1 else _MARGIN

    found = excluded_poses({name: each.trusted for name, each in results.items()}, results, lead, _CONFIG)
    assert {each.snapshot for each in found if each.outvoted} == {"stop 1", "stop 2"}
    disputed = [(each.snapshot, each.others) for each in found if not each.outvoted]
    assert disputed == ([("stop 4", ("stop 1", "stop 2"))] if dropped else [])


def test_an_excluded_pose_does_not_count():
    placements = (LidarPlacement("front", "the target"), LidarPlacement("rear", "placed", "placed", _WRONG))
    alone = replace(_FOUND, result=replace(_FOUND.result, placements=placements))
    runs = [alone, _run("stop 2", open_poses=[_TRUTH])]
    assert join(runs, _CONFIG)["rear"].placed
    found = join(runs, _CONFIG, lead_at=lambda *_: _MARGIN)
    assert not found["rear"].placed
    assert [report.outliers for report in found.snapshots] == [("rear",), ()]
    assert "stop 1: its pose is outvoted by stop 2, 8.000 m and 180.00 deg away" in found["rear"].reason


def test_the_target_of_a_stop_has_the_reason_of_the_other():
    """Which of the two LiDARs is the target of a stop depends on their overlap there."""
    run = _run("stop 1", open_poses=[_TRUTH])
    placements = (LidarPlacement("rear", "the target", "target", pose("rear", "rear")), run.result.placements[0])
    found = join([replace(run, result=replace(run.result, target="rear", placements=placements))], _CONFIG)
    assert found["rear"].reason == "stop 1: front is not placed relative to it: nothing in common"


@pytest.mark.parametrize("stop", ["stop 1", "stop 2"])
def test_beams_of_another_stop_refuse_a_pose_without_links(stop):
    """Of the stop that found the pose, they were heard before."""
    pairs = {"stop 1": (_told(_WRONG),), "stop 2": ()}

    def against(_, own):
        return stop if stop not in own else ""

    found = refine_linked("front", pairs, (), _CONFIG.refine, against)
    assert ("rear" in found.rig.poses) == (stop == "stop 1")


def test_a_stop_without_both_views_has_no_lead():
    stops = [DriveStop("stop 1", {}, ())]
    assert lead_at(stops, "stop 1", registration(_TRUTH), _WRONG) == -np.inf
    assert lead_at(stops, "stop 2", registration(_TRUTH), _WRONG) == -np.inf


@pytest.mark.slow
@pytest.mark.nightly
def test_between_equal_houses_one_stop_finds_a_wrong_pose_alone():
    """It turned the rear LiDAR by 180 degrees, 4.7 m off. The first two stops found other wrong ones, and more."""
    snapshots = simulate_drive("front_back", "equal_houses", 7000, route="straight", stops=4, frames=3).snapshots
    config = with_overrides(CalibrationConfig(), ["runtime.workers=1"])
    assert calibrate(snapshots[3], config).status == "complete"
    assert calibrate(snapshots, config).status != "complete"
