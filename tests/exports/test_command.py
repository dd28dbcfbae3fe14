# SPDX-License-Identifier: Apache-2.0
"""`multilica export`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica import RigidTransform, read_extrinsics
from multilica.checks import read_reference
from multilica.errors import InputError
from multilica.exports import CLOUD_FORMATS, FORMATS
from multilica.exports.files import rig_of_run
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import FloatArray
from multilica.runs.run_documents import read_run_document
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.exports.made_rigs import made_run, name_frames
from tests.runs.made_runs import made_truth
from tests.sinks.made_documents import made_document, parsed

MOUNT = RigidTransform.from_xyz_rpy("base_link", "front", [1.2, 0.1, 1.9], [0.01, 0.2, -0.3])


def truth(target: str, source: str) -> FloatArray:
    return made_truth().between(target, source).matrix


def assert_pose(path: str, target: str, source: str, expected: FloatArray) -> None:
    np.testing.assert_allclose(read_extrinsics(path).between(target, source).matrix, expected, rtol=0, atol=1e-9)


def write_rig(pose: RigidTransform = MOUNT) -> Path:
    table = extrinsics_table(Extrinsics(pose.target, {pose.source: pose}))
    Path("rig.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    return Path("rig.toml")


def test_a_run_is_exported(invoke: Invoke) -> None:
    outcome = invoke("export", made_run(Path("run")), "--to", "urdf", "--out", "rig.urdf")
    assert (outcome.code, outcome.err) == (ExitCode.DONE, "")
    assert outcome.out == "wrote rig.urdf: front, left, rear in front\n"
    assert_pose("rig.urdf", "front", "rear", truth("front", "rear"))
    assert read_extrinsics("rig.urdf").members == {"front", "left", "rear"}


def test_toml_has_covariances_and_biases(invoke: Invoke) -> None:
    run = made_run(Path("run"), sigmas=(0.01, 0.002))
    document = json.loads((run / "result.json").read_text(encoding="utf-8"))
    bias = {"range_m": 0.004, "range_sigma_m": 0.003, "elevation_deg": 0.001, "elevation_sigma_deg": 0.002}
    bias |= {"glancing_m": -0.001, "glancing_sigma_m": 0.004}
    bias |= {"range_scale_ppm": 120.0, "range_scale_sigma_ppm": 90.0}
    still = {"m": 0.0, "deg": 0.0}
    document["refinement"] = {"cycle_error_before": still, "cycle_error_after": still, "pairs": []}
    document["refinement"]["biases"] = [{"lidar": "left", **bias}]
    (run / "result.json").write_text(json.dumps(document), encoding="utf-8")
    name_frames(run, front="f", left="l", rear="r")
    assert invoke("export", run, "--to", "toml", "--out", "rig.toml", "--frames", "ids").code == ExitCode.DONE
    text = Path("rig.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["sensor_biases"] == {"l": bias}
    assert "No pose and no point is corrected by them." in text
    expected = np.diag([np.deg2rad(0.01) ** 2] * 3 + [0.002**2] * 3)
    np.testing.assert_allclose(read_extrinsics("rig.toml").covariances["l"], expected, rtol=1e-9)
    assert_pose("rig.toml", "f", "l", truth("front", "left"))
    known = read_reference(Path("rig.toml"), {"front": "f", "left": "l", "rear": "r"})
    assert (known.target, {*known.covariances}) == ("front", {"left", "rear"})


def test_toml_in_the_frame_of_a_lidar_has_covariances(invoke: Invoke) -> None:
    run = made_run(Path("run"), sigmas=(0.01, 0.002))
    assert invoke("export", run, "--to", "toml", "--out", "rig.toml", "--base", "left").err == ""
    found, known = read_extrinsics("rig.toml"), rig_of_run(read_run_document(run).document)[0]
    for name in ("front", "rear"):
        expected = known.covariance_between("left", name)
        np.testing.assert_allclose(found.covariance_between("left", name), expected, rtol=1e-9, atol=1e-18)
    document = json.loads((run / "result.json").read_text(encoding="utf-8"))
    document["lidars"]["left"]["covariance"] = None
    (run / "result.json").write_text(json.dumps(document), encoding="utf-8")
    outcome = invoke("export", run, "--to", "toml", "--out", "rig.toml", "--base", "left")
    assert outcome.err == "multilica: Without the covariance of rear, as the run has none of left.\n"


def test_every_format_is_in_the_help(invoke: Invoke) -> None:
    text = " ".join(invoke("export", "--help").out.replace("│", " ").split())
    assert [name for name in (*FORMATS, *CLOUD_FORMATS) if name not in text] == []


def test_what_is_not_placed_is_told(invoke: Invoke) -> None:
    run = made_run(Path("run"), absent=["left"])
    outcome = invoke("export", run, "--to", "csv", "--out", "rig.csv", "--quiet")
    assert (outcome.code, outcome.out) == (ExitCode.NOT_PLACED, "")
    assert outcome.err == "multilica: Without left (not placed).\n"
    assert read_extrinsics("rig.csv").members == {"front", "rear"}


def test_uncertain_lidars_are_exported_when_asked_for(invoke: Invoke) -> None:
    run = made_run(Path("run"), uncertain=True)
    refused = invoke("export", run, "--to", "csv", "--out", "rig.csv")
    assert_one_sentence(refused, ExitCode.INPUT)
    assert "nothing to export without --with-uncertain, which adds left, rear." in " ".join(refused.err.split())
    assert not Path("rig.csv").exists()
    outcome = invoke("export", run, "--to", "csv", "--out", "rig.csv", "--with-uncertain")
    assert (outcome.code, outcome.err) == (ExitCode.NOT_PLACED, "multilica: With left, rear, which are uncertain.\n")
    assert_pose("rig.csv", "front", "rear", truth("front", "rear"))


def test_one_uncertain_lidar_is_told_as_one(invoke: Invoke) -> None:
    run = made_run(Path("run"), uncertain=True, absent=["left"])
    outcome = invoke("export", run, "--to", "csv", "--out", "rig.csv", "--with-uncertain")
    assert outcome.err == "multilica: Without left (not placed).\nmultilica: With rear, which is uncertain.\n"


def test_an_uncertain_base_is_exported_when_asked_for() -> None:
    values = made_document()
    document = parsed(values | {"ground": values["ground"] | {"doubt": "it is seen on one side only"}})
    with pytest.raises(InputError, match="The base frame 'base' of the run is uncertain: it is seen on one side only"):
        rig_of_run(document, base="base")
    for found in (rig_of_run(parsed(values), base="base"), rig_of_run(document, base="base", with_uncertain=True)):
        assert (found[0].target, found[0].between("base", "top").xyz_m.tolist()) == ("base", [0.0, 0.0, 2.0])
    assert rig_of_run(document)[0].target == "top"


def test_a_base_is_another_name_of_the_target(invoke: Invoke) -> None:
    outcome = invoke("export", made_run(Path("run")), "--to", "autoware", "--out", "a.yaml", "--base", "base_link")
    assert outcome.out == "wrote a.yaml: front, left, rear in base_link\n"
    assert_pose("a.yaml", "base_link", "front", np.eye(4))
    assert_pose("a.yaml", "base_link", "left", truth("front", "left"))


def test_a_base_can_be_another_lidar(invoke: Invoke) -> None:
    invoke("export", made_run(Path("run")), "--to", "kitti", "--out", "a.txt", "--base", "rear")
    found = read_extrinsics("a.txt")
    assert (found.target, found.members) == ("rear", {"front", "left", "rear"})
    assert_pose("a.txt", "rear", "left", truth("rear", "left"))


@pytest.mark.parametrize(("frames", "base"), [("ids", "rear"), ("ids", "rear_link"), ("names", "rear_link")])
def test_a_base_is_a_lidar_by_name_or_frame_id(invoke: Invoke, frames: str, base: str) -> None:
    run = made_run(Path("run"))
    name_frames(run, front="front_link", left="left_link", rear="rear_link")
    assert invoke("export", run, "--to", "csv", "--out", "a.csv", "--frames", frames, "--base", base).code == 0
    rear, left = ("rear_link", "left_link") if frames == "ids" else ("rear", "left")
    assert_pose("a.csv", rear, left, truth("rear", "left"))


def test_a_base_is_no_lidar_without_a_pose(invoke: Invoke) -> None:
    run = made_run(Path("run"), absent=["rear"])
    name_frames(run, front="link", left="left_link", rear="left_link")
    outcome = invoke("export", run, "--to", "csv", "--out", "a.csv", "--base", "rear")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "rear is not placed and cannot be the common frame" in outcome.err
    outcome = invoke("export", run, "--to", "csv", "--out", "a.csv", "--base", "left_link")
    assert "2 LiDARs of the run have the frame id 'left_link'; give a LiDAR's name" in outcome.err
    assert not Path("a.csv").exists()
    assert invoke("export", run, "--to", "csv", "--out", "a.csv", "--base", "link").out.endswith("left in link\n")


@pytest.mark.parametrize("base", [[], ["--base", "base_link"]])
def test_a_rig_gives_the_base(invoke: Invoke, base: list[str]) -> None:
    run = made_run(Path("run"))
    outcome = invoke("export", run, "--to", "ros2-launch", "--out", "rig.py", "--rig", write_rig(), *base)
    assert outcome.code == ExitCode.DONE
    assert_pose("rig.py", "base_link", "left", MOUNT.matrix @ truth("front", "left"))
    assert_pose("rig.py", "base_link", "front", MOUNT.matrix)


def test_frame_ids_name_the_frames(invoke: Invoke) -> None:
    run = made_run(Path("run"))
    name_frames(run, front="/os_lidar", left="left_link", rear="rear_link")
    rig = write_rig(RigidTransform("base_link", "os_lidar", MOUNT.matrix))
    outcome = invoke("export", run, "--to", "tf-static", "--out", "r.mcap", "--frames", "ids", "--rig", rig)
    assert outcome.code == ExitCode.DONE
    assert_pose("r.mcap", "base_link", "rear_link", MOUNT.matrix @ truth("front", "rear"))
    assert_pose("r.mcap", "base_link", "os_lidar", MOUNT.matrix)


def test_a_rig_has_another_base_than_the_target(invoke: Invoke) -> None:
    run = made_run(Path("run"))
    name_frames(run, front="base_link", left="left_link", rear="rear_link")
    rest = ("--to", "csv", "--out", "r.csv", "--frames", "ids", "--rig", write_rig())
    outcome = invoke("export", run, *rest)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "The base frame 'base_link' has the name of a LiDAR of the run" in outcome.err


def test_an_existing_urdf_keeps_the_target(invoke: Invoke) -> None:
    run = made_run(Path("run"))
    invoke("export", run, "--to", "urdf", "--out", "car.urdf", "--rig", write_rig())
    text = Path("car.urdf").read_text(encoding="utf-8")
    moved = text.replace("1.2 0.1 1.9", "1.5 0.1 1.9")
    assert moved != text
    Path("car.urdf").write_text(moved, encoding="utf-8")
    assert invoke("export", run, "--to", "urdf", "--out", "car.urdf").code == ExitCode.DONE
    assert_pose("car.urdf", "front", "left", truth("front", "left"))
    np.testing.assert_allclose(read_extrinsics("car.urdf").between("base_link", "front").xyz_m, [1.5, 0.1, 1.9])
    invoke("export", run, "--to", "urdf", "--out", "car.urdf", "--rig", "rig.toml")
    assert_pose("car.urdf", "base_link", "left", MOUNT.matrix @ truth("front", "left"))


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (["--to", "urfd", "--out", "a.urdf"], ExitCode.USAGE, "Did you mean 'urdf'"),
        (["--to", "urdf", "--out", "a.txt"], ExitCode.USAGE, "ends in .urdf"),
        (["--to", "csv", "--out", "s3://bucket/a.csv"], ExitCode.USAGE, "found --out s3://bucket/a.csv"),
        (["--to", "csv", "--out", "https://user:secret@host/a.csv"], ExitCode.USAGE, "found --out https://host/a.csv"),
        (["--to", "csv", "--out", "no/a.csv"], ExitCode.USAGE, "no directory no"),
        (["--to", "csv", "--out", "a.csv", "--rig", "no.toml"], ExitCode.INPUT, "No extrinsics file at no.toml"),
        (["--to", "csv", "--out", "a.csv", "--rig", "rig.toml", "--base", "top"], ExitCode.USAGE, "no frame 'top'"),
        (["--to", "csv", "--out", "a.csv", "--rig", "far.csv"], ExitCode.INPUT, "at 1200.0, 100.0, 1900.0"),
        (["--to", "csv", "--out", "a.csv", "--rig", "other.csv"], ExitCode.USAGE, "no frame 'front' in other.csv"),
        (["--to", "csv", "--out", "a.csv", "--rig", "left.csv"], ExitCode.USAGE, "has the name of a LiDAR of the run"),
        (["--to", "csv", "--out", "a.csv", "--frames", "ids"], ExitCode.INPUT, "no frame id of 'front'"),
        (["--to", "csv", "--out", "a.csv", "--base", " "], ExitCode.USAGE, "no name that files can hold"),
        (["--to", "urdf", "--out", "car.urdf"], ExitCode.INPUT, "car.urdf has no joint with the child link 'rear'"),
        (["--to", "urdf", "--out", "car.urdf", "--base", "b"], ExitCode.USAGE, "give --base together with --rig"),
        (["--to", "ply", "--out", "a.ply"], ExitCode.INPUT, "has no result.mcap"),
    ],
)
def test_wrong_requests_get_a_sentence(invoke: Invoke, arguments: list[str], code: ExitCode, sentence: str) -> None:
    run = made_run(Path("run"))
    write_rig()
    head = "target,source,x_m,y_m,z_m,qx,qy,qz,qw\n"
    Path("far.csv").write_text(f"{head}base,front,1200,100,1900,0,0,0,1\n", encoding="utf-8")
    Path("other.csv").write_text(f"{head}base,top,1,0,0,0,0,0,1\n", encoding="utf-8")
    Path("left.csv").write_text(f"{head}left,front,1,0,0,0,0,0,1\n", encoding="utf-8")
    joint = '<joint name="j" type="fixed"><parent link="front"/><child link="left"/></joint>'
    Path("car.urdf").write_text(f'<robot name="r">{joint}</robot>', encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().glob("*.*")}
    outcome = invoke("export", run, *arguments)
    assert_one_sentence(outcome, code)
    assert sentence in outcome.err
    assert {path: path.read_bytes() for path in Path().glob("*.*")} == before


def test_equal_frame_ids_are_refused(invoke: Invoke) -> None:
    run = made_run(Path("run"))
    name_frames(run, front="lidar", left="lidar", rear="rear")
    outcome = invoke("export", run, "--to", "csv", "--out", "a.csv", "--frames", "ids")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "2 LiDARs of the run have the frame id 'lidar'" in outcome.err
