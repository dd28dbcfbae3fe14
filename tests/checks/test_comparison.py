# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from multilica.checks import RigTolerances, Tolerance, check_rig
from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import Knock, LidarPlacement, SnapshotReport
from multilica.results.calibration import SnapshotDeviation
from multilica.runs import SavedRun

POSES = {
    "front": RigidTransform.from_xyz_rpy("top", "front", (2.0, 0.1, -0.4), (0.0, 0.1, 0.0)),
    "left": RigidTransform.from_xyz_rpy("top", "left", (0.2, 0.9, -0.4), (0.0, 0.0, 1.6)),
    "rear": RigidTransform.from_xyz_rpy("top", "rear", (-2.1, -0.1, -0.5), (0.05, 0.0, 3.1)),
}
REFERENCE = Extrinsics("top", POSES)
PLAIN = "the reference has no covariance, so its own errors do not count"
SHIFT = ((0.03, 0.04, 0.0), (0.0, 0.0, 0.0))
TURN = ((0.0, 0.0, 0.0), (0.0, 0.0, np.deg2rad(0.5)))


def run_with(changes=None, sigma_m=0.001, sigma_deg=0.005, without=()):
    """A run in which some LiDARs are moved in their own frame."""
    variances = [np.deg2rad(sigma_deg) ** 2] * 3 + [sigma_m**2] * 3
    poses = POSES | {"top": RigidTransform.identity("top", "top")}
    for name, (xyz_m, rpy_rad) in (changes or {}).items():
        poses[name] = poses[name] @ RigidTransform.from_xyz_rpy(name, name, xyz_m, rpy_rad)
    to_target = poses["top"].inverse()
    placements = tuple(
        LidarPlacement(name, "nothing fits")
        if name in without
        else LidarPlacement(
            name,
            "placed",
            "placed",
            RigidTransform("top", name, to_target.matrix @ pose.matrix),
            covariance=None if name == "top" else np.diag(variances),
        )
        for name, pose in sorted(poses.items())
    )
    return SavedRun("run", "top", placements)


def checked(run, tolerances=None, reference=REFERENCE):
    return check_rig(run, reference, tolerances or RigTolerances())


def test_an_unchanged_rig_is_within():
    check = checked(run_with())
    assert (check.verdict, check.moved, check.notes, check.root) == ("within", (), (PLAIN,), "top")
    assert [each.lidar for each in check.lidars] == ["front", "left", "rear"]
    assert check.sentence == "All 4 LiDARs agree with the reference."


@pytest.mark.parametrize("motion", [SHIFT, TURN])
@pytest.mark.parametrize("lidar", ["front", "left", "rear", "top"])
def test_the_lidar_that_moved_is_named(lidar, motion):
    check = checked(run_with({lidar: motion}))
    assert (check.verdict, check.moved) == ("outside", (lidar,))
    (found,) = (each for each in check.lidars if each.lidar == lidar)
    expected = (0.05, 0.0) if motion is SHIFT else (0.0, 0.5)
    assert (found.distance_m, found.angle_deg) == pytest.approx(expected, abs=1e-9)
    assert check.root != lidar


@pytest.mark.parametrize(
    ("left_out", "by_m", "change", "verdict"),
    [
        (("stop 4",), 0.2, {}, "outside"),
        (("stop 4",), 0.02, {}, "within"),
        (("stop 4",), 0.2, {"rear": SHIFT}, "outside"),
        (("stop 4",), 0.06, {"rear": SHIFT}, "undecided"),
        (("stop 4",), 0.01, {"rear": SHIFT}, "outside"),
        (("stop 4",), 0.02, {"rear": ((0.02, 0.0, 0.0), (0.0, 0.0, 0.0))}, "undecided"),
        (("stop 1", "stop 2", "stop 3"), 0.2, {}, "within"),
        (("stop 1", "stop 2", "stop 3"), 0.2, {"rear": SHIFT}, "outside"),
    ],
)
def test_a_lidar_is_judged_by_where_it_is_now(left_out, by_m, change, verdict):
    knock = Knock("rear", "stop 3", "stop 4", by_m, 0.1, left_out)
    check = checked(replace(run_with(change), knocks=(knock,)))
    assert [each.verdict for each in check.lidars] == ["within", "within", verdict]
    assert check.notes[0] == knock.text
    assert check.lidars[2].reason.startswith("rear moved by") == ("stop 4" in left_out)


def test_the_lidar_that_was_knocked_is_no_root():
    knock = Knock("top", "stop 3", "stop 4", 0.2, 0.1, ("stop 4",))
    check = checked(replace(run_with(), knocks=(knock,)))
    assert (check.root, check.moved) == ("front", ("top",))
    pair = run_with(without=("left", "rear"))
    assert checked(replace(pair, knocks=(knock,))).moved == ("top",)


def test_all_are_outside_beside_a_root_that_was_knocked():
    """Both others agree with it alone."""
    knock = Knock("top", "stop 3", "stop 4", 0.2, 0.1, ("stop 4",))
    apart = {"front": ((0.02, 0.0, 0.0), (0.0, 0.0, 0.0)), "left": ((0.0, 0.02, 0.0), (0.0, 0.0, 0.0))}
    run = run_with(apart, without=("rear",))
    assert checked(run).root == "top"
    check = checked(replace(run, knocks=(knock,)))
    assert (check.root, check.moved) == ("top", ("front", "left"))


def test_a_snapshot_that_a_knock_explains_is_told_once():
    knock = Knock("rear", "monday", "tuesday", 0.02, 0.1, ("tuesday",))
    off = SnapshotDeviation("rear", 0.02, 0.1, outlier=True)
    snapshots = (SnapshotReport("tuesday", "", "", outliers=("rear",), deviations=(off,)),)
    told = [note for note in checked(replace(run_with(), snapshots=snapshots)).notes if "tuesday" in note]
    assert told == ["tuesday: OUTLIER: rear is off by 20.0 mm, 0.100 deg from the other snapshots"]
    told = [
        note for note in checked(replace(run_with(), knocks=(knock,), snapshots=snapshots)).notes if "tuesday" in note
    ]
    assert told == [knock.text]


def test_differences_are_along_the_axes_of_the_root():
    (found,) = (each for each in checked(run_with({"left": SHIFT})).lidars if each.lidar == "left")
    expected = POSES["left"].rotation @ SHIFT[0]
    assert found.translation_m == pytest.approx(expected, abs=1e-12)


def test_the_frame_of_the_reference_does_not_matter():
    base = RigidTransform.from_xyz_rpy("base", "top", (1.0, 0.2, 2.0), (0.1, 0.02, 1.0))
    poses = {name: base @ pose for name, pose in POSES.items()} | {"top": base}
    check = checked(run_with({"rear": TURN}), reference=Extrinsics("base", poses))
    assert check.moved == ("rear",)
    assert check.notes == (PLAIN,)


@pytest.mark.parametrize(
    ("sigma_m", "moved_m", "verdict", "said"),
    [
        (0.001, 0.029, "within", "29 mm of 30 mm"),
        (0.001, 0.031, "outside", "31 mm is above 30 mm"),
        (0.02, 0.031, "undecided", "49 % of unmoved LiDARs differ as much (sigma 20 mm)"),
        (0.04, 0.001, "undecided", "its sigma of 40 mm is above the tolerance of 30 mm"),
        (0.1022, 0.001, "undecided", "its sigma of 102 mm is above the tolerance of 30 mm"),
        (0.04, 1.2456, "outside", "1246 mm is above 30 mm"),
    ],
)
def test_sigma_and_tolerance_decide(sigma_m, moved_m, verdict, said):
    run = run_with({"rear": ((moved_m, 0.0, 0.0), (0.0, 0.0, 0.0))}, sigma_m=sigma_m)
    (rear,) = (each for each in checked(run).lidars if each.lidar == "rear")
    assert rear.verdict == verdict
    assert said in rear.reason


def test_of_a_long_sigma_the_part_along_the_difference_counts():
    loose = np.diag([1e-10] * 3 + [0.02**2, 1e-6, 1e-6])
    for axis, verdict in ((0, "undecided"), (1, "outside")):
        shift = POSES["rear"].rotation.T @ (0.04 * np.eye(3)[axis])
        run = run_with({"rear": (tuple(shift), (0.0, 0.0, 0.0))})
        placements = tuple(replace(each, covariance=loose) if each.lidar == "rear" else each for each in run.placements)
        (rear,) = (each for each in checked(SavedRun("run", "top", placements)).lidars if each.lidar == "rear")
        assert rear.verdict == verdict


def with_covariance(sigma_m=0.001, sigma_deg=0.005, lidars=tuple(POSES)):
    """The reference as a calibration gives it."""
    known = np.diag([np.deg2rad(sigma_deg) ** 2] * 3 + [sigma_m**2] * 3)
    return replace(REFERENCE, covariances=dict.fromkeys(lidars, known))


@pytest.mark.parametrize(
    ("reference_sigma_m", "verdict"), [(None, "outside"), (0.001, "outside"), (0.01, "undecided"), (0.03, "undecided")]
)
def test_the_covariance_of_the_reference_counts(reference_sigma_m, verdict):
    run = run_with({"rear": ((0.035, 0.0, 0.0), (0.0, 0.0, 0.0))}, sigma_m=0.004)
    reference = REFERENCE if reference_sigma_m is None else with_covariance(reference_sigma_m)
    check = checked(run, reference=reference)
    (rear,) = (each for each in check.lidars if each.lidar == "rear")
    sigma_m = np.hypot(0.004, reference_sigma_m or 0.0)
    assert rear.verdict == verdict
    assert rear.sigma_m == pytest.approx(sigma_m)
    assert rear.reference_sigma_m == (reference_sigma_m and pytest.approx(reference_sigma_m))
    assert rear.translation_probability == pytest.approx(chi2.sf((0.035 / sigma_m) ** 2, 3))
    assert rear.rotation_probability == pytest.approx(1.0)
    assert check.notes == (() if reference_sigma_m else (PLAIN,))


def test_a_loose_reference_decides_nothing():
    check = checked(run_with(), reference=with_covariance(sigma_m=0.04))
    assert (check.verdict, {each.verdict for each in check.lidars}) == ("undecided", {"undecided"})
    turned = checked(run_with({"rear": TURN}), reference=with_covariance(sigma_deg=0.2))
    assert turned.lidars[-1].verdict == "undecided"
    assert "% of unmoved LiDARs differ as much (sigma 0.2 deg)" in turned.lidars[-1].reason


def test_lidars_without_a_covariance_in_the_reference_are_named():
    check = checked(run_with(), reference=with_covariance(lidars=("front", "left")))
    assert check.notes == ("the reference has no covariance of rear, so its own errors do not count",)
    assert [each.reference_sigma_m for each in check.lidars] == [pytest.approx(0.001), pytest.approx(0.001), None]


@pytest.mark.slow  # a rare outcome takes hundreds of draws
@pytest.mark.in_turn
def test_unmoved_lidars_are_found_outside_as_rarely_as_stated():
    rng, sigma_m, flagged = np.random.default_rng(1), 0.025, 0
    reference = with_covariance(sigma_m, 1e-4)
    for _ in range(300):
        off = {name: (tuple(np.hypot(1.0, 1.0) * sigma_m * rng.normal(size=3)), (0.0, 0.0, 0.0)) for name in POSES}
        flagged += checked(run_with(off, sigma_m, 1e-4), reference=reference).verdict == "outside"
    assert flagged <= 4  # three LiDARs at one in a thousand; more than four of 300 happen in one of 400 cases


def test_a_turned_root_adds_its_sigma_with_its_lever():
    run = run_with({"top": TURN}, sigma_m=1e-6, sigma_deg=0.1)
    (top,) = (each for each in checked(run).lidars if each.lidar == "top")
    assert top.sigma_m == pytest.approx(np.deg2rad(0.1) * 2.0, rel=0.1)


def test_the_largest_sigma_is_told_if_it_is_known():
    run = run_with(sigma_m=0.002, sigma_deg=0.01)
    assert [(each.sigma_m, each.sigma_deg) for each in checked(run).lidars] == [pytest.approx((0.002, 0.01))] * 3
    bare = tuple(replace(each, covariance=None) for each in run.placements)
    check = checked(SavedRun("run", "top", bare))
    assert check.verdict == "within"
    assert {(each.sigma_m, each.sigma_deg) for each in check.lidars} == {(None, None)}


def test_with_nothing_placed_there_is_still_a_root():
    without = (*POSES, "top")
    assert checked(run_with(without=without)).root == "top"
    fewer = Extrinsics("front", {name: POSES["front"].inverse() @ POSES[name] for name in POSES})
    check = checked(run_with(without=without), reference=fewer)
    assert (check.root, [each.lidar for each in check.lidars]) == ("front", ["left", "rear"])


@pytest.mark.parametrize("base", ["front", "base_link"])
def test_a_single_placed_lidar_is_the_root(base):
    """The target of the run is not in the reference, and another of its LiDARs is not placed."""
    T_base_top = RigidTransform("base_link", "top", np.eye(4)) if base == "base_link" else POSES["front"].inverse()
    poses = {name: T_base_top @ POSES[name] for name in ("front", "rear") if name != base}
    check = checked(run_with(without=("front",)), reference=Extrinsics(base, poses))
    assert (check.root, [each.lidar for each in check.lidars], check.verdict) == ("rear", ["front"], "undecided")


def test_what_is_not_placed_is_undecided():
    check = checked(run_with(without=("rear",)))
    assert check.verdict == "undecided"
    assert check.lidars[-1].reason == "not placed: nothing fits"
    assert check.sentence == "rear cannot be decided."


def test_of_two_which_one_moved_cannot_be_told():
    moved = dict.fromkeys(("rear",), ((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)))
    poses = {name: POSES[name] for name in ("rear",)}
    run = run_with(moved, without=("front", "left"))
    check = checked(run, reference=Extrinsics("top", poses))
    assert check.moved == ("rear",)
    assert "so the one that moved is unknown" in check.notes[0]


def test_own_tolerances_count():
    tolerances = RigTolerances.model_validate({"lidars": {"rear": {"translation_m": 0.06}}})
    assert checked(run_with({"rear": SHIFT}), tolerances).verdict == "within"
    assert checked(run_with({"left": SHIFT}), tolerances).moved == ("left",)
    assert tolerances.of("rear") == Tolerance(translation_m=0.06, rotation_deg=0.3)


def own(**translations_m):
    return RigTolerances.model_validate({"lidars": {name: {"translation_m": m} for name, m in translations_m.items()}})


def shifted(*lidars, by_m=0.025):
    return dict.fromkeys(lidars, ((by_m, 0.0, 0.0), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize("lidar", ["front", "left", "rear", "top"])
def test_a_strict_tolerance_counts_for_any_lidar(lidar):
    check = checked(run_with(shifted(lidar)), own(**{lidar: 0.01}))
    assert (check.moved, check.notes) == ((lidar,), (PLAIN,))
    (found,) = (each for each in check.lidars if each.lidar == lidar)
    assert found.max_translation_m == 0.01
    assert checked(run_with(shifted(lidar))).verdict == "within"


@pytest.mark.parametrize("strict", ["top", "rear"])
def test_of_two_lidars_the_strict_tolerance_counts(strict):
    run, two = run_with(shifted("rear"), without=("front", "left")), Extrinsics("top", {"rear": POSES["rear"]})
    check = checked(run, own(**{strict: 0.01}), reference=two)
    assert (check.verdict, check.lidars[0].lidar) == ("outside", strict)
    assert "so the one that moved is unknown" in check.notes[0]
    both = checked(run, own(top=0.02, rear=0.03), reference=two)
    assert (both.moved, both.lidars[0].max_translation_m) == (("rear",), 0.02)


@pytest.mark.parametrize("loose", ["top", "rear"])
def test_of_two_lidars_a_loose_tolerance_counts(loose):
    run, two = run_with(shifted(loose, by_m=0.04), without=("front", "left")), {"rear": POSES["rear"]}
    check = checked(run, own(**{loose: 0.05}), reference=Extrinsics("top", two))
    assert (check.verdict, check.notes[1:]) == ("within", ("the reference has no pose of front and left",))


def test_a_loose_lidar_agrees_where_all_have_own_tolerances():
    own_of_all = own(top=0.02, front=0.02, left=0.02, rear=0.05)
    assert checked(run_with(shifted("rear", by_m=0.04)), own_of_all).verdict == "within"
    assert checked(run_with(shifted("rear", by_m=0.06)), own_of_all).moved == ("rear",)


def test_strict_lidars_that_move_together_are_not_hidden():
    half = own(top=0.01, front=0.01, left=0.03, rear=0.03)
    shift = {name: (tuple(pose.rotation.T @ (0.025, 0.0, 0.0)), (0.0, 0.0, 0.0)) for name, pose in POSES.items()}
    check = checked(run_with({name: shift[name] for name in ("left", "rear")}), half)
    assert (check.root, check.moved) == ("top", ("left", "rear"))
    assert "so the one that moved is unknown" in check.notes[0]


def test_names_that_do_not_fit_are_refused():
    with pytest.raises(UsageError, match="have 0 LiDAR\\(s\\) in common"):
        checked(run_with(), reference=Extrinsics("a", {"b": POSES["rear"]}))
    with pytest.raises(UsageError, match="tolerance for 'reer'"):
        checked(run_with(), RigTolerances.model_validate({"lidars": {"reer": {"rotation_deg": 1.0}}}))


def test_what_only_one_side_has_is_noted():
    fewer = Extrinsics("top", {name: POSES[name] for name in ("front", "left")})
    assert checked(run_with(), reference=fewer).notes == (PLAIN, "the reference has no pose of rear")
    more = Extrinsics("top", POSES | {"roof": POSES["rear"]})
    assert checked(run_with(), reference=more).notes == (PLAIN, "run has no LiDAR roof")
