# SPDX-License-Identifier: Apache-2.0
"""Claimed poses from every kind of source."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica.errors import InputError, SourceNotFoundError, UnfitPriorError, UnreadableSourceError, UsageError
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica.ingest import read_prior
from multilica.snapshot import LidarScans, Scan, Snapshot

NAMES = ("front", "left", "rear")
FRAME_IDS = {"front": "front", "left": "left_optical", "rear": "rear_link"}
POSES = {
    "front": RigidTransform.from_xyz_rpy("base", "front", (1.5, 0.1, 2.0), (0.01, 0.1, 0.02)),
    "left": RigidTransform.from_xyz_rpy("base", "left", (0.1, 0.7, 2.1), (0.3, -0.2, 1.6)),
    "rear": RigidTransform.from_xyz_rpy("base", "rear", (-1.4, 0.0, 2.0), (0.0, 0.1, 3.1)),
}
TRUTH = Extrinsics("base", POSES)
MAST = RigidTransform.from_xyz_rpy("base", "mast", (0.0, 0.3, 1.0), (0.2, 0.1, -0.4))


def snapshot(*static: RigidTransform) -> Snapshot:
    scan = Scan(np.ones((3, 3)))
    lidars = tuple(LidarScans(name, (scan,), FRAME_IDS[name]) for name in NAMES)
    return Snapshot(lidars, "drive.mcap", static_transforms=static)


def over_a_mast(frames: dict[str, str]) -> tuple[RigidTransform, ...]:
    """The same rig, its left LiDAR on a mast."""
    poses = [RigidTransform(pose.target, frames[name], pose.matrix) for name, pose in POSES.items()]
    held = MAST.inverse() @ poses[1]
    return (poses[0], MAST, held, poses[2])


def toml(path: Path, extrinsics: Extrinsics) -> str:
    path.write_text(tomli_w.dumps(extrinsics_table(extrinsics)), encoding="utf-8")
    return str(path)


def urdf(path: Path, poses: tuple[RigidTransform, ...], kinds: dict[str, str]) -> str:
    joints = "".join(
        f'<joint name="to {pose.source}" type="{kinds.get(pose.source, "fixed")}"><parent link="{pose.target}"/>'
        f'<child link="{pose.source}"/><origin xyz="{_row(pose.xyz_m)}" rpy="{_row(pose.rpy_rad)}"/></joint>'
        for pose in poses
    )
    path.write_text(f"<robot>{joints}</robot>", encoding="utf-8")
    return str(path)


def _row(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def made_source(kind: str, folder: Path, frames: dict[str, str]) -> tuple[str, Snapshot]:
    if kind == "tf":
        return "tf", snapshot(*over_a_mast(frames))
    if kind == "toml":
        renamed = {frames[name]: RigidTransform("base", frames[name], pose.matrix) for name, pose in POSES.items()}
        return toml(folder / "truth.toml", Extrinsics("base", renamed)), snapshot()
    wheel = RigidTransform.identity("base", "wheel")
    return urdf(folder / f"car.{kind}", (*over_a_mast(frames), wheel), {"wheel": "continuous"}), snapshot()


@pytest.mark.parametrize("kind", ["tf", "toml", "urdf", "xml"])
@pytest.mark.parametrize("frames", [{name: name for name in NAMES}, FRAME_IDS], ids=["by name", "by frame id"])
def test_every_kind_of_source_says_the_same(kind: str, frames: dict[str, str], tmp_path: Path) -> None:
    prior = read_prior(*made_source(kind, tmp_path, frames))
    assert prior.notes == ()
    assert prior.extrinsics.members == {*NAMES}
    for target, source in permutations(NAMES, 2):
        found = prior.extrinsics.between(target, source)
        assert (found.target, found.source) == (target, source)
        np.testing.assert_allclose(found.matrix, TRUTH.between(target, source).matrix, atol=1e-9)


def test_a_name_goes_before_a_frame_id(tmp_path: Path) -> None:
    decoy = RigidTransform.identity("base", "left_optical")
    prior = read_prior(toml(tmp_path / "a.toml", Extrinsics("base", {**POSES, "left_optical": decoy})), snapshot())
    np.testing.assert_allclose(
        prior.extrinsics.between("front", "left").matrix, TRUTH.between("front", "left").matrix, atol=1e-9
    )


def test_a_calibration_with_a_lidar_as_its_root_is_a_prior(tmp_path: Path) -> None:
    poses = {name: TRUTH.between("left", name) for name in NAMES}
    prior = read_prior(toml(tmp_path / "calibration.toml", Extrinsics("left", poses)), snapshot())
    np.testing.assert_allclose(
        prior.extrinsics.between("rear", "left").matrix, TRUTH.between("rear", "left").matrix, atol=1e-9
    )


def test_a_lidar_that_the_prior_lacks_is_noted() -> None:
    prior = read_prior("tf", snapshot(POSES["front"], POSES["rear"]))
    assert prior.extrinsics.members == {"front", "rear"}
    assert prior.notes == ("The recording's /tf_static has no pose of left: calibrated without a prior.",)


def test_a_lidar_that_nothing_joins_to_the_others_is_noted() -> None:
    apart = RigidTransform.identity("workshop", "front")
    prior = read_prior("tf", snapshot(apart, POSES["left"], POSES["rear"]))
    assert prior.extrinsics.members == {"left", "rear"}
    assert prior.notes == (
        "The recording's /tf_static does not connect front with left, rear: calibrated without a prior.",
    )


@pytest.mark.parametrize(
    ("static", "told"),
    [
        ((), "has 0 of the LiDARs front, left, rear; .*frames: none"),
        ((POSES["left"],), "has 1 of the LiDARs front, left, rear; .*two or more.*frames: base, left"),
        (
            (POSES["left"], RigidTransform.identity("x", "rear")),
            "has 2 of the LiDARs front, left, rear, which are not connected",
        ),
        (tuple(RigidTransform.identity("base", f"f{n:02}") for n in range(20)), "f10 and 9 more"),
    ],
)
def test_fewer_than_two_joined_lidars_are_no_prior(static: tuple[RigidTransform, ...], told: str) -> None:
    with pytest.raises(UnfitPriorError, match=told):
        read_prior("tf", snapshot(*static))


def test_a_joint_that_moves_between_two_lidars_is_named(tmp_path: Path) -> None:
    path = urdf(tmp_path / "car.urdf", over_a_mast(FRAME_IDS), {"mast": "revolute"})
    told = r"joins the LiDAR frames 'front' and 'left_optical' through 'to mast', a revolute joint; .*fixed"
    with pytest.raises(UnfitPriorError, match=told):
        read_prior(path, snapshot())


@pytest.mark.parametrize(
    ("name", "error", "told"),
    [
        ("nowhere.toml", SourceNotFoundError, "nowhere.toml"),
        ("nowhere.urdf", SourceNotFoundError, "nowhere.urdf"),
        ("nowhere", SourceNotFoundError, "No prior at .*expected 'tf', a .toml file of extrinsics or a .urdf file"),
        ("notes.txt", UsageError, "notes.txt is of an unknown kind"),
        ("car.urdf.xacro", UnreadableSourceError, "run xacro first"),
    ],
)
def test_what_is_no_prior_is_refused(name: str, error: type[Exception], told: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("one metre to the left")
    (tmp_path / "car.urdf.xacro").write_text("<robot/>")
    with pytest.raises(error, match=told) as refusal:
        read_prior(str(tmp_path / name), snapshot())
    assert len(str(refusal.value).splitlines()) == 1
    assert isinstance(refusal.value, InputError | UsageError)


def test_a_recording_without_static_transforms_says_what_is_read() -> None:
    with pytest.raises(UnfitPriorError, match=r"/tf_static has 0 of .* Poses on /tf are read only if a static"):
        read_prior("tf", snapshot())
