# SPDX-License-Identifier: Apache-2.0
"""Largest differences of a rig from its reference that do not count as drift."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from multilica.documents import MAX_TOML_BYTES, DocumentError, first_problem, parse_toml, read_limited
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.runs.pose_error import PoseError

_Metres = Annotated[float, Strict(), Field(gt=0.0, le=100.0)]
_Degrees = Annotated[float, Strict(), Field(gt=0.0, le=180.0)]


class Tolerance(BaseModel):
    """Largest difference that does not count as drift."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    translation_m: _Metres = 0.03
    rotation_deg: _Degrees = 0.3

    def holds(self, error: PoseError) -> bool:
        """Return whether an error is within it."""
        return error.distance_m <= self.translation_m and error.angle_deg <= self.rotation_deg


class RigTolerances(BaseModel):
    """The tolerance of all LiDARs, and what differs for some."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    default: Tolerance = Tolerance()
    lidars: Mapping[str, Tolerance] = Field(default_factory=dict)

    def of(self, lidar: str) -> Tolerance:
        """Return the tolerance of one LiDAR."""
        own = self.lidars[lidar].model_dump(exclude_unset=True) if lidar in self.lidars else {}
        return self.default.model_copy(update=own)

    def has_own(self, lidar: str) -> bool:
        """Return whether one LiDAR has a tolerance of its own."""
        return lidar in self.lidars

    def smaller(self, lidar: str, other: str) -> Tolerance:
        """Return the tolerance of a LiDAR, or that of another one where it is smaller."""
        both = self.of(lidar), self.of(other)
        return Tolerance(
            translation_m=min(each.translation_m for each in both), rotation_deg=min(each.rotation_deg for each in both)
        )

    def beside(self, lidar: str, root: str) -> Tolerance:
        """Return the tolerance of a LiDAR, or what the root has of its own where that is smaller."""
        if not self.has_own(root):
            return self.of(lidar)
        own = self.lidars[root].model_dump(exclude_unset=True)
        found = self.of(lidar)
        return found.model_copy(update={name: min(value, getattr(found, name)) for name, value in own.items()})

    def without(self, lidars: Collection[str]) -> "RigTolerances":
        """Return the tolerances without those of some LiDARs."""
        left = {name: own for name, own in self.lidars.items() if name not in lidars}
        return self.model_copy(update={"lidars": left})


def read_tolerances(path: Path, default: Tolerance) -> RigTolerances:
    """Read a TOML file with ``[default]`` and ``[lidars.NAME]``; the default holds where the file has no value.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is not TOML, or has other keys or values.
    """
    try:
        values = parse_toml(read_limited(path, MAX_TOML_BYTES))
        found = RigTolerances.model_validate(values)
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No file of tolerances at {path}.") from error
    except (OSError, DocumentError) as error:
        raise UnreadableSourceError(f"{path} is not a TOML file that can be read: {error}.") from error
    except ValidationError as error:
        where, what, _ = first_problem(error)
        raise UnreadableSourceError(
            f"{path} is not a file of tolerances: {where}: {what}; expected [default] and [lidars.NAME], each with "
            "translation_m and rotation_deg."
        ) from error
    return found.model_copy(update={"default": default.model_copy(update=found.default.model_dump(exclude_unset=True))})
