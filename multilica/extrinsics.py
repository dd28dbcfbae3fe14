# SPDX-License-Identifier: Apache-2.0
"""Where the LiDARs of a rig sit, as a table that files hold."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multilica.errors import SourceNotFoundError, UnknownNameError, UnreadableSourceError
from multilica.geometry import RigidTransform

__all__ = ["EXTRINSICS_SCHEMA", "Extrinsics", "extrinsics_table", "read_extrinsics"]

EXTRINSICS_SCHEMA = "multilica/extrinsics/1"


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """Poses of LiDARs in one common frame.

    Args:
        target: the common frame: a LiDAR's name, or a base frame.
        T_target_source: per LiDAR, its pose in the common frame.
    """

    target: str
    T_target_source: Mapping[str, RigidTransform]

    @property
    def members(self) -> frozenset[str]:
        """Everything whose pose is known, the common frame included."""
        return frozenset({*self.T_target_source, self.target})

    def between(self, target: str, source: str) -> RigidTransform:
        """``T_target_source`` of any two members.

        Raises:
            UnknownNameError: one of the two is not in the table.
        """
        return self._pose(target).inverse() @ self._pose(source)

    def _pose(self, name: str) -> RigidTransform:
        if name == self.target:
            return RigidTransform.identity(name, name)
        if name not in self.T_target_source:
            raise UnknownNameError("LiDAR", name, self.members)
        return self.T_target_source[name]


def extrinsics_table(extrinsics: Extrinsics) -> dict[str, Any]:
    """The table as TOML-ready values; each pose with its numbers in every form that people ask for."""
    return {
        "schema": EXTRINSICS_SCHEMA,
        "target": extrinsics.target,
        "convention": "p_target = T_target_source @ p_source",
        "length_unit": "m",
        "rpy_convention": "degrees, extrinsic xyz: roll, then pitch, then yaw about the fixed axes of the target",
        "lidars": {name: _pose_table(pose) for name, pose in sorted(extrinsics.T_target_source.items())},
    }


def _pose_table(pose: RigidTransform) -> dict[str, Any]:
    return {
        "xyz_m": pose.xyz_m.tolist(),
        "rpy_deg": pose.rpy_deg.tolist(),
        "quaternion_xyzw": pose.quaternion_xyzw.tolist(),
        "T_target_source": pose.matrix.tolist(),
    }


def read_extrinsics(path: Path) -> Extrinsics:
    """Read what a table of `extrinsics_table` became as TOML; further keys are ignored.

    Where a LiDAR has no `T_target_source`, as in a table that a person wrote, its `xyz_m` and `rpy_deg` are taken.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: not TOML, or not such a table.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No extrinsics file at {path}.") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UnreadableSourceError(f"{path} is not a TOML file that can be read: {error}.") from error
    if table.get("schema") != EXTRINSICS_SCHEMA:
        raise UnreadableSourceError(
            f"{path} has schema {table.get('schema')!r}; expected '{EXTRINSICS_SCHEMA}', "
            "as calibration.toml and truth files have it."
        )
    try:
        target = str(table["target"])
        poses = {str(name): _read_pose(target, str(name), entry) for name, entry in table["lidars"].items()}
    except KeyError as error:
        raise UnreadableSourceError(f"{path} is not a table of extrinsics: it has no {error}.") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise UnreadableSourceError(f"{path} is not a table of extrinsics: {error}.") from error
    return Extrinsics(target, poses)


def _read_pose(target: str, lidar: str, entry: Mapping[str, Any]) -> RigidTransform:
    if "T_target_source" in entry:
        return RigidTransform(target, lidar, np.asarray(entry["T_target_source"], dtype=np.float64))
    return RigidTransform.from_xyz_rpy(target, lidar, entry["xyz_m"], np.deg2rad(entry["rpy_deg"]).tolist())
