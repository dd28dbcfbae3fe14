# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from multilica import read_extrinsics, read_snapshot
from multilica.checks import RigTolerances, check_rig, decide_unplaced, verify_snapshot
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.runs import SavedRun
from multilica.simulate import simulate_snapshot
from multilica_cli.commands.calibrate import find_sample

LIMITS = RigTolerances()


@pytest.fixture(scope="module")
def snapshot():
    return read_snapshot(find_sample().recording)


def reference(lidar="", shift_m=0.0):
    truth = read_extrinsics(find_sample().truth)
    poses = {name: truth.between("left", name).matrix.copy() for name in sorted(truth.members)}
    if lidar:
        poses[lidar][0, 3] += shift_m
    return Extrinsics("left", {name: RigidTransform("left", name, pose) for name, pose in poses.items()})


def run_without(lidar):
    """A calibration that places all others exactly."""
    truth = reference()
    placed = {name: truth.between("left", name) for name in sorted(truth.members - {lidar})}
    covariance = np.eye(6) * 1e-8
    placements = [LidarPlacement(name, "", "placed", pose, covariance=covariance) for name, pose in placed.items()]
    return SavedRun("run", "left", (*placements, LidarPlacement(lidar, "too little evidence")))


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(("shift_m", "verdict"), [(0.0, "within"), (0.05, "outside")])
def test_an_unplaced_lidar_is_decided_from_its_known_pose(snapshot, shift_m, verdict):
    known = reference("rear", shift_m)
    check = check_rig(run_without("rear"), known, LIMITS)
    assert {each.lidar: each.verdict for each in check.lidars}["rear"] == "undecided"
    decided = {each.lidar: each for each in decide_unplaced(check, snapshot, known, LIMITS).lidars}
    assert decided["rear"].verdict == verdict
    assert "registered from the reference" in decided["rear"].reason
    assert {name: each for name, each in decided.items() if name != "rear"} == {
        each.lidar: each for each in check.lidars if each.lidar != "rear"
    }


def test_a_check_with_all_lidars_placed_is_left_alone(snapshot):
    known = reference()
    placed = tuple(LidarPlacement(name, "", "placed", known.between("left", name)) for name in sorted(known.members))
    check = check_rig(SavedRun("run", "left", placed), known, LIMITS)
    assert decide_unplaced(check, snapshot, known, LIMITS) is check


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("rig", "scene", "seed", "frames"),
    [("sides", "bridge", 3015, 10), ("edgar", "motorway", 907, 1)],
    ids=["what is left of cars that crept", "one frame"],
)
def test_cars_that_moved_are_not_taken_for_a_lidar_that_did(rig, scene, seed, frames):
    """By all points a LiDAR may seem centimetres off, by more than its sigma."""
    made = simulate_snapshot(rig, scene, seed, frames=frames, disturbances=("traffic:queue",))
    check = verify_snapshot(made.snapshot, made.truth, LIMITS)
    assert {each.verdict for each in check.lidars} == {"within", "undecided"}
