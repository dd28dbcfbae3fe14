# SPDX-License-Identifier: Apache-2.0
"""Types of numbers, vectors and poses in the documents that a run leaves behind, with a text that is read back."""

from __future__ import annotations

import math
from typing import Annotated, Any, NoReturn, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    WithJsonSchema,
    field_validator,
)
from pydantic_core import PydanticOmit
from pydantic_core.core_schema import literal_schema, with_default_schema
from typing_extensions import TypeAliasType

from multilica.documents import require_length
from multilica.geometry import RigidTransform

OPEN_POSE = "the scene leaves its pose open in one direction"
"""Begins the reason of a LiDAR whose pairs were accepted, but do not hold its pose."""

COVERED = "sigma covers that"
"""A contradiction follows these words in the reason of a LiDAR whose covariance is wider for it."""
LEAST_IMPLAUSIBLE = 4.0
"""A bias of a LiDAR beyond so many of its standard deviations is none that its datasheet allows."""

ONLY_GROUND = "only the ground tells its height"
ONLY_MOTION = "only its motion between the stops and the ground tell its pose"
"""Begins the reason of a LiDAR that no pair and no link places."""

BY_CONTRADICTING = "connected through pairs that contradict other snapshots"
"""The LiDARs on which they do follow these words in the reason of a LiDAR."""


def _plain(value: Any) -> Any:  # noqa: ANN401
    """Return an array as lists, and None for a number, or for an array with a number, that is not finite."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return value if _finite(value) else None


def _finite(value: object) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _rigid(rows: _Rows4) -> _Rows4:
    for value_m in RigidTransform("", "", np.asarray(rows)).matrix[:3, 3]:
        require_length(value_m)
    return rows


def not_in_document(default: object = None) -> tuple[object, ...]:
    """Return the annotations of a field that documents leave out; it has the default in a value that is read."""
    schema = with_default_schema(literal_schema([default]), default=default)
    return GetPydanticSchema(lambda *_: schema, _omit), Field(exclude=True)


def _omit(*_: object) -> NoReturn:
    raise PydanticOmit


Vector3 = TypeAliasType("Vector3", tuple[float, float, float])
Quaternion = TypeAliasType("Quaternion", tuple[float, float, float, float])
Row4 = TypeAliasType("Row4", tuple[float, float, float, float])
Row6 = TypeAliasType("Row6", tuple[float, float, float, float, float, float])
_Rows4 = tuple[Row4, Row4, Row4, Row4]

Number = Annotated[float | None, BeforeValidator(_plain)]
Matrix4 = TypeAliasType("Matrix4", Annotated[_Rows4, AfterValidator(_rigid)])
Matrix6 = TypeAliasType("Matrix6", tuple[Row6, Row6, Row6, Row6, Row6, Row6])


Figure = Annotated[
    float,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda value: math.nan if value is None else value),
    PlainSerializer(_plain, when_used="json"),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "null"}]}),
]
"""A number that is NaN where it is not known, in a document null."""


class Entry(BaseModel):
    """A frozen part of a document, without unknown keys or numbers that are not finite."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        from_attributes=True,
        serialize_by_alias=True,
        defer_build=True,
    )

    _to_plain = field_validator("*", mode="before")(_plain)

    @classmethod
    def of(cls, *sources: object, **values: object) -> Self:
        """Fill an entry with those values, else with the attributes of the same name of the last source."""
        found = {name: getattr(each, name) for each in sources for name in cls.model_fields if hasattr(each, name)}
        return cls(**found | values)


Target = Annotated[str, Field(description="LiDAR whose frame the pose maps to.")]
Source = Annotated[str, Field(description="LiDAR whose frame the pose maps from.")]


class PairNames(Entry):
    """The two LiDARs of a pair."""

    target: Target
    source: Source

    @property
    def key(self) -> tuple[str, str]:
        """Target and source."""
        return self.target, self.source

    @property
    def names(self) -> frozenset[str]:
        """Both names, without order."""
        return frozenset((self.target, self.source))


class PoseEntry(Entry):
    """A pose in every form that readers ask for."""

    T_target_source: Matrix4 = Field(description="Rows of the matrix: p_target = T_target_source @ p_source.")
    xyz_m: Vector3 = Field(description="Position of the source in the target frame.")
    rpy_deg: Vector3 = Field(description="Roll, pitch, yaw, extrinsic xyz, about the fixed axes of the target.")
    quaternion_xyzw: Quaternion = Field(description="Rotation as a unit quaternion, w last.")
