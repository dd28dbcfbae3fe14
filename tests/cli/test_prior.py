# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate --prior`."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path

import pytest
import tomli_w

from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, true_pose, write_pcd


@pytest.mark.slow
def test_a_lidar_that_is_mounted_backwards_is_placed_and_named(invoke: Invoke, two_lidars: Path) -> None:
    turned = true_pose("left", "right") @ RigidTransform.from_xyz_rpy("right", "right", (0, 0, 0), (0, 0, pi))
    table = extrinsics_table(Extrinsics("left", {"right": turned}))
    Path("drawing.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    outcome = invoke("calibrate", two_lidars, "--target", "left", "--out", "run", "--prior", "drawing.toml")
    assert outcome.code == ExitCode.DONE
    rows = {words[0]: words for line in outcome.out.splitlines() if len(words := line.split()) == 13}
    assert [float(number) for number in rows["right"][2:5]] == pytest.approx(turned.xyz_m, abs=0.02)
    off_mm, off_deg = (float(number) for number in rows["right"][-2:])
    assert off_mm < 20.0
    assert off_deg == pytest.approx(180.0, abs=0.2)
    assert rows["left"][-2:] == ["-", "-"]
    (said,) = (line for line in outcome.out.splitlines() if "Warning: right is turned by 180 deg about its z" in line)
    assert "mounted backwards" in said


@pytest.mark.slow
def test_the_recordings_own_transforms_are_tried(invoke: Invoke) -> None:
    sample = find_sample().recording
    outcome = invoke("calibrate", sample, "--out", "run", "--prior", "tf", "--until", "preprocess", "--json", "--quiet")
    assert outcome.code == ExitCode.DONE
    lidars = json.loads(outcome.out)["lidars"]
    assert all(lidar["prior"]["T_target_source"] for lidar in lidars.values())


def test_a_lidar_without_a_prior_is_noted(invoke: Invoke, two_lidars: Path, tmp_path: Path) -> None:
    extra = write_pcd(tmp_path / "extra.pcd", [(2.0, 0.0, float(z)) for z in range(9)])
    files = (two_lidars / "left.pcd", two_lidars / "right.pcd", extra)
    truth = find_sample().truth
    outcome = invoke("calibrate", *files, "--out", "run", "--prior", truth, "--until", "preprocess")
    assert outcome.code == ExitCode.DONE
    assert f"note: {truth} has no pose of extra: calibrated without a prior." in outcome.err


@pytest.mark.parametrize(
    ("options", "code", "named"),
    [
        (["--prior", "tf"], ExitCode.INPUT, "/tf_static has 0 of the LiDARs left, right"),
        (["--prior", "nowhere.toml"], ExitCode.INPUT, "nowhere.toml"),
        (["--prior", "nowhere.urdf"], ExitCode.INPUT, "nowhere.urdf"),
        (["--prior", "car.xacro"], ExitCode.INPUT, "run xacro first"),
        (["--prior", "notes.txt"], ExitCode.INPUT, "notes.txt"),
        (["--prior", "nowhere.csv"], ExitCode.INPUT, "nowhere.csv"),
        (["--prior", "drawing.toml", "--preset", "paper"], ExitCode.USAGE, "verify.enabled"),
    ],
)
def test_a_prior_that_cannot_be_used_leaves_nothing(
    options: list[str], code: ExitCode, named: str, invoke: Invoke, two_lidars: Path
) -> None:
    Path("car.xacro").write_text("<robot/>", encoding="utf-8")
    Path("notes.txt").touch()
    Path("drawing.toml").write_bytes(find_sample().truth.read_bytes())
    outcome = invoke("calibrate", two_lidars, "--out", "run", "--quiet", *options)
    assert_one_sentence(outcome, code)
    assert named in outcome.err
    assert not Path("run").exists()
