# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate --base --rig`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica import read_extrinsics
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, write_pcd

TRUTH = read_extrinsics(find_sample().truth)


def drawn(target: str, *lidars: str) -> Path:
    """A rig file that has the true x, y and yaw, but another height, roll and pitch."""
    poses = {}
    for lidar in lidars:
        pose = TRUTH.between(TRUTH.target, lidar)
        (x, y, z), (roll, pitch, yaw) = pose.xyz_m.tolist(), pose.rpy_rad.tolist()
        poses[lidar] = RigidTransform.from_xyz_rpy(target, lidar, [x, y, z + 0.3], [roll + 0.02, pitch - 0.03, yaw])
    Path("rig.toml").write_text(tomli_w.dumps(extrinsics_table(Extrinsics(target, poses))), encoding="utf-8")
    return Path("rig.toml")


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_run_is_exported_in_its_base_frame(invoke: Invoke, two_lidars: Path) -> None:
    rig = drawn("wheels", "left")
    outcome = invoke("calibrate", two_lidars, "--target", "left", "--rig", rig, "--out", "run")
    assert outcome.code == ExitCode.DONE, outcome.err
    assert "ground, frame wheels: left is" in outcome.out
    ground = json.loads(Path("run/result.json").read_text(encoding="utf-8"))["ground"]
    np.testing.assert_allclose(ground["T_base_target_rig"], read_extrinsics(rig).between("wheels", "left").matrix)
    for arguments in ((), ("--base", "wheels"), ("--base", "left")):
        assert invoke("export", "run", "--to", "csv", "--out", "rig.csv", *arguments).code == ExitCode.DONE
        found = read_extrinsics("rig.csv")
        assert found.target == (arguments[1] if arguments else "wheels")
        if found.target == "wheels":
            metres, radians = found.between("wheels", "left").distance_to(_true("wheels", "left"))
            assert metres < 0.005
            assert radians < np.deg2rad(0.05)


def _true(target: str, lidar: str) -> RigidTransform:
    return RigidTransform(target, lidar, TRUTH.between(TRUTH.target, lidar).matrix)


@pytest.mark.parametrize(
    ("options", "code", "named"),
    [
        (["--rig", "rig.toml", "--base", "axle"], ExitCode.USAGE, "'axle'"),
        (
            ["--rig", "rig.toml"],
            ExitCode.USAGE,
            "no pose of 'right', which may become the target; give --target, one of left",
        ),
        (["--rig", "rig.toml", "--target", "right"], ExitCode.USAGE, "no pose of 'right'"),
        (["--rig", "rig.toml", "--target", "left", "--base", "left"], ExitCode.USAGE, "has the name of a LiDAR"),
        (["--rig", "nowhere.urdf"], ExitCode.INPUT, "nowhere.urdf"),
        (["--rig", "millimetres.toml", "--target", "left"], ExitCode.INPUT, "expected metres"),
    ],
)
def test_wrong_rigs_get_a_sentence(
    invoke: Invoke, two_lidars: Path, options: list[str], code: ExitCode, named: str
) -> None:
    drawn("wheels", "left")
    far = RigidTransform.from_xyz_rpy("wheels", "left", [1450.0, 0.0, 2100.0], [0.0, 0.0, 0.0])
    Path("millimetres.toml").write_text(tomli_w.dumps(extrinsics_table(Extrinsics("wheels", {"left": far}))))
    outcome = invoke("calibrate", two_lidars, "--out", "run", "--quiet", *options)
    assert_one_sentence(outcome, code)
    assert named in outcome.err
    assert not Path("run").exists()


def test_a_base_with_the_name_of_a_lidar_gets_a_sentence(invoke: Invoke, two_lidars: Path) -> None:
    outcome = invoke("calibrate", two_lidars, "--base", "right", "--out", "run", "--quiet")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "The base frame 'right' has the name of a LiDAR; choose another name (--base)." in outcome.err
    assert not Path("run").exists()


@pytest.mark.slow
def test_no_ground_is_told_with_its_own_code(invoke: Invoke, two_lidars: Path) -> None:
    for lidar in ("left", "right"):
        pose = _true("wheels", lidar)
        points_m = np.loadtxt(two_lidars / f"{lidar}.pcd", skiprows=11)[:, :3]
        write_pcd(Path(f"walls/{lidar}.pcd"), points_m[pose.apply(points_m)[:, 2] > 0.5])
    outcome = invoke("calibrate", "walls", "--target", "left", "--base", "wheels", "--out", "run")
    document = json.loads(Path("run/result.json").read_text(encoding="utf-8"))
    assert outcome.code == ExitCode.NOT_PLACED
    assert document["ground"] is None or document["ground"]["doubt"]
    assert "base frame" in outcome.out
