# SPDX-License-Identifier: Apache-2.0
from functools import cache

import numpy as np
import pytest

from multilica import events
from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest import read_prior
from multilica.pipeline import calibrate
from multilica.results import PRIOR
from multilica.simulate import simulate_snapshot
from multilica.snapshot import LidarScans, Scan, Snapshot

_NO_DESCRIPTORS = ("features.voxel_size_m=3", "features.retry_voxel_sizes_m=[]")
_SAME_M, _SAME_RAD = 0.002, np.deg2rad(0.02)


@cache
def _rig(name):
    return simulate_snapshot(name, "garage", 101, frames=1, sensors="ideal")


def _two(rig, *names):
    """Two LiDARs of a rig with half of their returns, and the recording's transforms."""
    whole = _rig(rig).snapshot
    lidars = tuple(LidarScans(name, (Scan(whole[name].scans[0].points_m[::2]),)) for name in names)
    return Snapshot(lidars, "two", static_transforms=whole.static_transforms)


def _claim(xyz_m=(0.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 0.0)):
    """Make a prior whose left LiDAR is moved and turned in its own frame."""
    off = RigidTransform.from_xyz_rpy("left", "left", xyz_m, np.deg2rad(rpy_deg).tolist())
    return Extrinsics("top", {"left": _rig("sides").truth.between("top", "left") @ off})


def _calibrated(prior, *settings, snapshot=None):
    config = with_overrides(CalibrationConfig(target="top"), ["fine.max_finalists=2", *settings])
    seen = []
    return calibrate(snapshot or _two("sides", "left", "top"), config, seen.append, prior), seen


@pytest.fixture(scope="module")
def without():
    return _calibrated(None)[0]


def _assert_same(one, other, metres=_SAME_M, radians=_SAME_RAD):
    apart_m, apart_rad = one.distance_to(other)
    assert apart_m < metres
    assert apart_rad < radians


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    "off",
    [((0, 0, 0), (0, 0, 180)), ((0.3, -0.4, 0.0), (3, 0, 4)), ((500.0, 0.0, 0.0), (0, 0, 0))],
    ids=["backwards", "half a metre and 5 degrees off", "in millimetres"],
)
def test_a_wrong_prior_does_not_change_the_result(off, without):
    result, _ = _calibrated(_claim(*off))
    assert (result.status, result.target) == (without.status, without.target) == ("complete", "top")
    _assert_same(result["left"].T_target_source, without["left"].T_target_source)
    assert result["left"].fitness == pytest.approx(without["left"].fitness, abs=0.005)


@pytest.mark.slow
def test_a_right_prior_places_what_the_descriptors_do_not_find():
    lost, _ = _calibrated(None, *_NO_DESCRIPTORS)
    assert not lost["left"].placed
    result, seen = _calibrated(_claim((0.05, 0.03, -0.02), (1, 2, 0)), *_NO_DESCRIPTORS)
    assert result["left"].placed
    _assert_same(result["left"].T_target_source, _rig("sides").truth.between("top", "left"), 0.02, np.deg2rad(0.1))
    (pair,) = result.pairs
    assert pair.start_label == PRIOR
    (found,) = (event.coarse for event in seen if isinstance(event, events.HypothesesFound))
    assert found.hypotheses[pair.hypothesis].origin == PRIOR


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("rpy_deg", [(0, 0, 180), (0, 90, 0)], ids=["backwards", "on its side"])
def test_from_a_prior_turned_around_the_true_pose_is_found(rpy_deg):
    """The wrong pose is tried turned by right angles about each axis of the garage, and the true one is among them."""
    result, _ = _calibrated(_claim(rpy_deg=rpy_deg), *_NO_DESCRIPTORS)
    metres, _ = result["left"].T_target_source.distance_to(_rig("sides").truth.between("top", "left"))
    assert metres < 0.02


@pytest.mark.slow
def test_a_wrong_prior_alone_places_nothing():
    result, _ = _calibrated(_claim(rpy_deg=(0, 60, 30)), *_NO_DESCRIPTORS)
    assert not result["left"].placed
    assert result["left"].T_target_source is None
    assert result["left"].T_target_source_prior is not None
    assert result["left"].prior_deviation is None
    assert result.pairs[0].verdict.outcome == "reject"


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_right_prior_does_not_place_what_shares_no_surface():
    simulation = _rig("blind")
    snapshot = _two("blind", "front_left", "rear")
    names = ("front_left", "rear")
    prior = Extrinsics("base", {name: simulation.truth.T_target_source[name] for name in names})
    result, seen = _calibrated(prior, "target=front_left", snapshot=snapshot)
    assert not result["rear"].placed
    (verified,) = (event.registrations for event in seen if isinstance(event, events.HypothesesVerified))
    assert PRIOR in [each.origin for each in verified]


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_transforms_of_a_recording_are_a_prior():
    snapshot = _two("sides", "left", "top")
    claimed = {pose.source: pose for pose in snapshot.static_transforms}
    result, seen = _calibrated(read_prior("tf", snapshot).extrinsics, snapshot=snapshot)
    expected = claimed["top"].inverse() @ claimed["left"]
    placement = result["left"]
    np.testing.assert_allclose(placement.T_target_source_prior.matrix, expected.matrix, atol=1e-12)
    assert placement.prior_deviation == pytest.approx(expected.distance_to(placement.T_target_source))
    assert placement.prior_deviation[0] > 0.02
    assert result["top"].prior_deviation == pytest.approx((0.0, 0.0), abs=1e-9)
    assert seen[0].prior.members == {"left", "top"}
    _assert_same(placement.T_target_source, _rig("sides").truth.between("top", "left"), 0.02, np.deg2rad(0.1))


def test_without_a_prior_nothing_is_compared(without):
    assert [placement.T_target_source_prior for placement in without.placements] == [None, None]
    assert [placement.prior_deviation for placement in without.placements] == [None, None]


@pytest.mark.slow
def test_a_lidar_that_the_prior_lacks_is_calibrated_without_one():
    nearby = RigidTransform.identity("top", "camera")
    whole = _rig("sides").snapshot
    thinned = tuple(LidarScans(name, (Scan(whole[name].scans[0].points_m[::8]),)) for name in ("left", "right", "top"))
    prior = Extrinsics("top", {"right": _rig("sides").truth.between("top", "right"), "camera": nearby})
    result, seen = _calibrated(prior, "until=coarse", snapshot=Snapshot(thinned))
    tried = {
        (event.coarse.target, event.coarse.source): [one.origin for one in event.coarse.hypotheses].count(PRIOR)
        for event in seen
        if isinstance(event, events.HypothesesFound)
    }
    assert tried == {("left", "right"): 0, ("left", "top"): 0, ("right", "top"): 1}
    assert result["left"].T_target_source_prior is None


@pytest.mark.parametrize(
    ("config", "prior", "message"),
    [
        (preset("paper"), _claim, r"checked by stage verify, which is off \(verify.enabled=false, preset 'paper'\)"),
        (
            CalibrationConfig(),
            lambda: Extrinsics("base", {"left": RigidTransform.identity("base", "left")}),
            r"has 1 LiDAR\(s\) of two \(left\); it needs two or more of left, top",
        ),
        (CalibrationConfig(), lambda: Extrinsics("base", {}), r"has 0 LiDAR\(s\) of two \(none\)"),
    ],
)
def test_a_prior_that_cannot_help_is_refused_before_any_work(config, prior, message):
    seen = []
    with pytest.raises(UsageError, match=message):
        calibrate(_two("sides", "left", "top"), config, seen.append, prior())
    assert seen == []
