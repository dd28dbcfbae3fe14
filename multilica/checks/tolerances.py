# SPDX-License-Identifier: Apache-2.0
"""Largest differences of a LiDAR from its reference that are accepted."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from multilica.documents import MAX_TOML_BYTES, DocumentError, first_problem, parse_toml, read_limited
from multilica.errors import SourceNotFoundError, UnreadableSourceError

_Metres = Annotated[float, Strict(), Field(gt=0.0, le=100.0)]
_Degrees = Annotated[float, Strict(), Field(gt=0.0, le=180.0)]


class Tolerance(BaseModel):
    """Largest difference that does not count as drift."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    translation_m: _Metres = 0.03
    rotation_deg: _Degrees = 0.3


class _OfLidar(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    translation_m: _Metres | None = None
    rotation_deg: _Degrees | None = None


class RigTolerances(BaseModel):
    """The tolerance of all LiDARs, and what differs for some."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    default: Tolerance = Tolerance()
    lidars: Mapping[str, _OfLidar] = Field(default_factory=dict)

    def of(self, lidar: str) -> Tolerance:
        """Return the tolerance of one LiDAR."""
        own = self.lidars[lidar].model_dump(exclude_none=True) if lidar in self.lidars else {}
        return self.default.model_copy(update=own)


def read_tolerances(path: Path, default: Tolerance) -> RigTolerances:
    """Read a TOML file with ``[default]`` and ``[lidars.NAME]``, each with `translation_m` and `rotation_deg`.

    Args:
        default: holds where the file has no value.

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
    given = found.default.model_dump(include=found.default.model_fields_set)
    return found.model_copy(update={"default": default.model_copy(update=given)})
