# SPDX-License-Identifier: Apache-2.0
"""Commands that compare with known poses read every format."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from multilica.exports import FORMATS
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.exports.made_rigs import made_run

NAMES = {
    "toml": "rig.toml",
    "urdf": "rig.urdf",
    "ros2-launch": "rig.launch.py",
    "ros2-static": "rig.sh",
    "ros1-launch": "rig.launch",
    "tf-static": "rig.mcap",
    "autoware": "rig.yaml",
    "kalibr": "rig.yaml",
    "csv": "rig.csv",
    "opencalib": "rig.json",
}


@pytest.mark.parametrize("kind", NAMES)
def test_a_run_is_the_same_as_its_export(invoke: Invoke, kind: str) -> None:
    run, file = made_run(Path("run")), NAMES[kind]
    assert invoke("export", run, "--to", kind, "--out", file, "--quiet").code == ExitCode.DONE
    for first, second in ((run, file), (file, run), (file, file)):
        outcome = invoke("diff", first, second, "--json")
        assert outcome.code == ExitCode.DONE, outcome
        assert {move["moved"] for move in json.loads(outcome.out)["moves"].values()} == {False}
    assert invoke("evaluate", run, "--truth", file).code == ExitCode.DONE


def test_other_formats_are_known() -> None:
    """KITTI's and plain matrices have the names of frames, not those of LiDARs."""
    assert {*FORMATS} - {*NAMES} == {"kitti", "matrices"}


@pytest.mark.parametrize("kind", ["kitti", "matrices"])
def test_the_same_matrices_do_not_differ(invoke: Invoke, kind: str) -> None:
    run = made_run(Path("run"))
    assert invoke("export", run, "--to", kind, "--out", "rig.txt", "--quiet").code == ExitCode.DONE
    assert invoke("diff", "rig.txt", "rig.txt").code == ExitCode.DONE
    Path("moved.txt").write_text(_moved(Path("rig.txt").read_text()))
    assert invoke("diff", "rig.txt", "moved.txt").code == ExitCode.DIFFERENT


def _moved(text: str) -> str:
    """Add a metre to the last number that is a translation: that of the last row but 0 0 0 1."""
    lines = text.rstrip().splitlines()
    row = next(i for i in reversed(range(len(lines))) if float(lines[i].split()[-2]) != 0.0)
    *values, shift = lines[row].split()
    lines[row] = " ".join([*values, f"{float(shift) + 1.0}"])
    return "\n".join(lines) + "\n"


def test_a_moved_and_a_missing_lidar_are_told(invoke: Invoke) -> None:
    head = "target,source,x_m,y_m,z_m,qx,qy,qz,qw\n"
    Path("one.csv").write_text(f"{head}base,a,0,0,0,0,0,0,1\nbase,b,1,0,0,0,0,0,1\nbase,c,2,0,0,0,0,0,1\n")
    Path("two.csv").write_text(f"{head}base,a,0,0,0,0,0,0,1\nbase,b,1.05,0,0,0,0,0,1\n")
    outcome = invoke("diff", "one.csv", "two.csv", "--json")
    assert outcome.code == ExitCode.DIFFERENT
    document = json.loads(outcome.out)
    assert document["moves"]["b"]["distance_m"] == pytest.approx(0.05)
    assert document["statuses"]["c"]["after"] == "missing"
    Path("three.csv").write_text(f"{head}z,y,0,0,0,0,0,0,1\n")
    assert_one_sentence(invoke("diff", "one.csv", "three.csv"), ExitCode.INPUT)
