# SPDX-License-Identifier: Apache-2.0
"""A moment of a data set with its truth."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.exports import read_extrinsics
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.snapshot import Snapshot

MAIN_LIDAR = "main_lidar"
"""The reference LiDAR in the evaluation files that the paper's authors publish."""
_NAMES = ("truth.toml", "truth.yaml", "config.yaml")
_SECTION = re.compile(r"^ground_truth:[^\n]*\n((?:[ \t#][^\n]*\n|\n)*)", re.MULTILINE)
_POSE = re.compile(r"^[ \t]+([\w./-]+):\s*\[([^\]]*)\]", re.MULTILINE)


@dataclass(frozen=True, slots=True, eq=False)
class DatasetScene:
    """The scans of a vehicle that stands still, with the truth.

    Args:
        name: unique in the data set, and valid as the name of a folder.
        truth: None if the data set has none.
        target: the LiDAR that the data set's truth or the paper refers to; empty: the calibration chooses.
    """

    name: str
    snapshot: Snapshot
    truth: Extrinsics | None
    target: str = ""


@dataclass(frozen=True, slots=True)
class SceneRequest:
    """Which scenes to read.

    Args:
        scenes: largest number of scenes.
        frames: frames per LiDAR and scene.
        topics: LiDAR name -> its topic in recordings.
        truth: file with the truth of all scenes; None: the data set's own.

    Raises:
        UsageError: no scene, or no frame.
    """

    scenes: int = 10
    frames: int = 5
    topics: Mapping[str, str] = field(default_factory=dict)
    truth: Path | None = None

    def __post_init__(self) -> None:
        if self.scenes < 1 or self.frames < 1:
            raise UsageError(f"Found {self.scenes} scenes of {self.frames} frames; expected at least one of each.")


def extrinsics_of(target: str, poses: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> Extrinsics:
    """Make a table of poses from positions in metres and extrinsic xyz angles in degrees by LiDAR."""
    made = {
        name: RigidTransform.from_xyz_rpy(target, name, xyz_m, np.deg2rad(rpy_deg).tolist())
        for name, (xyz_m, rpy_deg) in poses.items()
    }
    return Extrinsics(target, made)


def find_truth(*folders: Path) -> Path | None:
    """Return the first file ``truth.toml``, ``truth.yaml`` or ``config.yaml`` in the folders; None if there is none."""
    found = (folder / name for folder in folders for name in _NAMES if (folder / name).is_file())
    return next(found, None)


def read_truth(path: Path) -> Extrinsics:
    """Read a TOML table as `simulate` writes it, or a YAML file as the paper's authors publish it.

    Such a YAML file has a section ``ground_truth`` with an entry per LiDAR: ``[x, y, z, roll, pitch, yaw]`` in metres
    and degrees (extrinsic xyz), or ``[x, y, z, qx, qy, qz, qw]``, all in one frame.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: not such a file.
    """
    if path.suffix == ".toml":
        return read_extrinsics(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No truth at {path}.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableSourceError(f"{path} is not a text file that can be read: {error}.") from error
    section = _SECTION.search(f"{text}\n")
    entries = _POSE.findall(section[1]) if section else []
    if not entries:
        raise UnreadableSourceError(
            f"{path} has no poses below 'ground_truth:'; expected lines 'LIDAR: [x, y, z, roll, pitch, yaw]'."
        )
    return Extrinsics("truth", {name: _pose(path, name, numbers) for name, numbers in entries})


def _pose(path: Path, name: str, numbers: str) -> RigidTransform:
    try:
        values = [float(number) for number in numbers.split(",") if number.strip()]
        if len(values) == 6:
            return RigidTransform.from_xyz_rpy("truth", name, values[:3], np.deg2rad(values[3:]).tolist())
        if len(values) == 7:
            return RigidTransform.from_xyz_quaternion("truth", name, values[:3], values[3:])
    except ValueError as error:
        raise UnreadableSourceError(f"{path} has no pose of '{name}' that can be read: {error}.") from error
    raise UnreadableSourceError(
        f"{path} has {len(values)} numbers for '{name}'; expected 6 (x, y, z, roll, pitch, yaw) or 7 (x, y, z, "
        "quaternion)."
    )
