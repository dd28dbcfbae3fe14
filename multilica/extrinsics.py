# SPDX-License-Identifier: Apache-2.0
"""Poses of the LiDARs of a rig, in memory and as a TOML table."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from multilica.documents import (
    MAX_TOML_BYTES,
    DocumentError,
    first_problem,
    local_path,
    parse_toml,
    read_limited,
    require_length,
    shown,
)
from multilica.errors import InputError, SourceNotFoundError, UnknownNameError, UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform, skew

EXTRINSICS_SCHEMA: Literal["multilica/extrinsics/1"] = "multilica/extrinsics/1"
_NORM_TOLERANCE = 0.01
Number = Annotated[float, Strict(), AfterValidator(require_length)]
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """Poses of LiDARs in one common frame: the frame of a LiDAR, or a base frame.

    Args:
        moving: the joints between the common frame and a frame that are not fixed, by frame, for messages.
        covariances: (6, 6) of the poses, order rotation (rad), translation (m), along the axes of the common frame, as
            far as they are known; zeros for the LiDAR to which the others were calibrated.
    """

    target: str
    T_target_source: Mapping[str, RigidTransform]
    moving: Mapping[str, frozenset[str]] = field(default_factory=dict)
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def members(self) -> frozenset[str]:
        """Everything whose pose is known, the common frame included."""
        return frozenset({*self.T_target_source, self.target})

    def between(self, target: str, source: str) -> RigidTransform:
        """``T_target_source`` of any two members.

        Raises:
            UnknownNameError: one of the two is not in the table.
            InputError: a joint between the two moves.
        """
        joints = self.moving.get(target, frozenset()) ^ self.moving.get(source, frozenset())
        if joints:
            raise InputError(f"'{source}' is joined to '{target}' through {min(joints)}; expected fixed joints only.")
        return self._pose(target).inverse() @ self._pose(source)

    def seen_from(self, T_base_target: RigidTransform) -> "Extrinsics":
        """Return the same poses in a base frame, where the target has a pose of its own.

        The pose of the base counts as exact, unless the base is a LiDAR with a pose of its own: then each covariance is
        that of the two, and includes what is not known of the base.
        """
        base = T_base_target.target
        poses = {frame: T_base_target @ self.between(self.target, frame) for frame in self.members if frame != base}
        if not self.covariances:
            return Extrinsics(base, dict(sorted(poses.items())))
        turn = np.kron(np.eye(2), T_base_target.rotation)
        covariances = {}
        for frame in sorted(poses):
            if base in self.T_target_source:
                known = self.covariance_between(base, frame)
            else:
                own = self.covariance(frame)
                known = None if own is None else turn @ own @ turn.T
            if known is not None:
                covariances[frame] = known
        return Extrinsics(base, dict(sorted(poses.items())), covariances=covariances)

    def covariance(self, name: str) -> FloatArray | None:
        """Return the (6, 6) covariance of a member's pose; None if it is not known."""
        return np.zeros((6, 6)) if name == self.target else self.covariances.get(name)

    def covariance_between(self, target: str, source: str) -> FloatArray | None:
        """Return the (6, 6) covariance of ``T_target_source``, along the target's axes; None if it is not known.

        It is the sum of those of both poses, as if they shared no errors: usually too large, at most a sixth too small.
        """
        root, pose = self._pose(target), self._pose(source)
        of_root, of_pose = self.covariance(target), self.covariance(source)
        if of_root is None or of_pose is None:
            return None
        moved_by_root = np.eye(6)
        moved_by_root[3:, :3] = -skew(pose.xyz_m - root.xyz_m)
        turn = np.kron(np.eye(2), root.rotation.T)
        return np.asarray(turn @ (of_pose + moved_by_root @ of_root @ moved_by_root.T) @ turn.T)

    def _pose(self, name: str) -> RigidTransform:
        if name == self.target:
            return RigidTransform.identity(name, name)
        if name not in self.T_target_source:
            raise UnknownNameError("LiDAR", name, self.members)
        return self.T_target_source[name]


class PoseTable(BaseModel):
    """The pose of a LiDAR in a TOML table, in every form that readers ask for; a matrix takes precedence."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    xyz_m: Three | None = None
    rpy_deg: Three | None = None
    quaternion_xyzw: Four | None = None
    T_target_source: tuple[Four, Four, Four, Four] | None = None
    covariance: tuple[Six, Six, Six, Six, Six, Six] | None = None

    @model_validator(mode="after")
    def _check_pose(self) -> Self:
        self.pose("", "")
        if self.covariance is not None:
            values = np.asarray(self.covariance)
            if not np.allclose(values, values.T) or np.linalg.eigvalsh(values)[0] < -1e-9 * np.trace(values):
                raise ValueError("'covariance' is not symmetric and positive")
        return self

    def pose(self, target: str, lidar: str) -> RigidTransform:
        """Return the pose under those names.

        Raises:
            ValueError: not a rigid transform.
        """
        if self.T_target_source is not None:
            return RigidTransform(target, lidar, np.asarray(self.T_target_source))
        if self.xyz_m is not None and self.rpy_deg is None and self.quaternion_xyzw is not None:
            length = float(np.linalg.norm(self.quaternion_xyzw))
            if not abs(length - 1.0) < _NORM_TOLERANCE:
                raise ValueError(f"it has a 'quaternion_xyzw' of length {length:.3g}; expected 1")
            return RigidTransform.from_xyz_quaternion(target, lidar, self.xyz_m, self.quaternion_xyzw)
        if self.xyz_m is None or self.rpy_deg is None:
            missing = "xyz_m" if self.xyz_m is None else "rpy_deg"
            raise ValueError(
                f"it has no '{missing}'; expected T_target_source, or xyz_m with rpy_deg or quaternion_xyzw"
            )
        return RigidTransform.from_xyz_rpy(target, lidar, self.xyz_m, np.deg2rad(self.rpy_deg).tolist())


class ExtrinsicsTable(BaseModel):
    """Extrinsics as a TOML table."""

    model_config = ConfigDict(frozen=True, serialize_by_alias=True)

    schema_: Literal["multilica/extrinsics/1"] = Field(alias="schema")
    target: str
    convention: str = "p_target = T_target_source @ p_source"
    length_unit: str = "m"
    rpy_convention: str = "degrees, extrinsic xyz: roll, then pitch, then yaw about the fixed axes of the target"
    lidars: Mapping[str, PoseTable]
    uncertain: Mapping[str, PoseTable] = Field(default_factory=dict, exclude=True)


def require_metres(pose: RigidTransform, where: str) -> None:
    """Refuse a pose that is farther off than any vehicle is long.

    Raises:
        InputError: so far off; `where` begins its sentence.
    """
    if max(abs(pose.xyz_m)) > 100.0:  # longer than any vehicle: millimetres
        found = ", ".join(str(value) for value in pose.xyz_m.tolist())
        raise InputError(f"{where} has '{pose.source}' at {found} in '{pose.target}'; expected metres.")


def extrinsics_table(extrinsics: Extrinsics) -> dict[str, Any]:
    """Return the extrinsics as values for TOML."""
    covariances = {name: covariance.tolist() for name, covariance in extrinsics.covariances.items()}
    lidars = {
        name: PoseTable(**pose_values(pose), covariance=covariances.get(name))
        for name, pose in sorted(extrinsics.T_target_source.items())
    }
    table = ExtrinsicsTable(schema=EXTRINSICS_SCHEMA, target=extrinsics.target, lidars=lidars)
    return table.model_dump(mode="json", exclude_none=True)


def pose_values(pose: RigidTransform) -> dict[str, Any]:
    """Return a pose in every form that readers ask for."""
    return {
        "xyz_m": pose.xyz_m.tolist(),
        "rpy_deg": pose.rpy_deg.tolist(),
        "quaternion_xyzw": pose.quaternion_xyzw.tolist(),
        "T_target_source": pose.matrix.tolist(),
    }


def read_extrinsics_table(path: str | Path, *, with_uncertain: bool = False) -> Extrinsics:
    """Read extrinsics from a TOML table, such as `calibration.toml` or a truth file; further keys are ignored.

    Args:
        path: of the file; ``~`` stands for the home folder.
        with_uncertain: also take the LiDARs that `calibration.toml` lists as uncertain.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: not TOML, or not such a table.
    """
    path = local_path(path)
    try:
        values = parse_toml(read_limited(path, MAX_TOML_BYTES))
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No extrinsics file at {path}.") from error
    except (OSError, DocumentError) as error:
        raise UnreadableSourceError(f"{path} is not a TOML file that can be read: {error}.") from error
    if values.get("schema") != EXTRINSICS_SCHEMA:
        raise UnreadableSourceError(
            f"{path} has schema {shown(values.get('schema'))}; expected '{EXTRINSICS_SCHEMA}', "
            "as calibration.toml and truth files have it."
        )
    try:
        table = ExtrinsicsTable.model_validate(values)
    except ValidationError as error:
        where, what, _ = first_problem(error)
        raise UnreadableSourceError(f"{path} is not a table of extrinsics: {where}: {what}.") from error
    entries = {**(table.uncertain if with_uncertain else {}), **table.lidars}
    return Extrinsics(
        table.target,
        {name: entry.pose(table.target, name) for name, entry in entries.items()},
        covariances={name: np.asarray(one.covariance) for name, one in entries.items() if one.covariance is not None},
    )
