# SPDX-License-Identifier: Apache-2.0
"""Findings in the poses of a fleet: the output of `multilica fleet drift`, for programs and for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, PlainSerializer, computed_field

from multilica.fleet.store.records import day_of, moment

ChangeKind = Literal["jump", "creep"]
MovedPart = Literal["lidar", "target", "lidar or target"]
OffsetScope = Literal["fleet", "vehicle", "fleet or vehicle"]
Vector = tuple[float, float, float]

_NS_PER_DAY = 86_400_000_000_000
_RATE_DAYS = 30.0
_CAUSES = {"dead_sensor": "returns nothing", "dirty_sensor": "has a dirty window"}
_TimeNs = Annotated[int, PlainSerializer(lambda time_ns: moment(time_ns).isoformat())]
_RotationRad = Annotated[Vector, PlainSerializer(lambda rotation_rad: np.rad2deg(rotation_rad).tolist())]


class DriftEvent(BaseModel, frozen=True):
    """A LiDAR, or the target of a vehicle's LiDARs, that moved.

    Attributes:
        lidars: whose poses changed significantly, in name order; of one LiDAR that moved, itself.
        moved: the LiDAR, the target, or one of the two where no other LiDAR beside the target tells them apart.
        key, time_ns: of the first log after a jump, or of the first log until which a creep has moved the LiDAR by more
            than one sigma of that log's own pose.
        last_before_key, last_before_time_ns: of the last log before a jump, or of the first log of a creep.
        last_key, last_time_ns: of the last log of a creep; `key` and `time_ns` for a jump.
        translation_m, rotation_rad: motion of the LiDAR, or of the target, along the target's axes; of a creep from its
            first log to its last.
        p_value: share of LiDARs that never moved and seem to as clearly.
    """

    vehicle: str
    lidars: tuple[str, ...]
    target: str
    kind: ChangeKind
    moved: MovedPart
    key: str = Field(serialization_alias="first_log")
    time_ns: _TimeNs = Field(serialization_alias="first_time")
    last_before_key: str = Field(serialization_alias="last_before_log")
    last_before_time_ns: _TimeNs = Field(serialization_alias="last_before_time")
    last_key: str = Field(exclude=True)
    last_time_ns: int = Field(exclude=True)
    translation_m: Vector
    rotation_rad: _RotationRad = Field(serialization_alias="rotation_deg")
    p_value: float

    @property
    def part(self) -> str:
        """The moved part, for people."""
        if self.moved == "target":
            return f"the target {self.target}"
        return f"{self.lidars[0]} or the target {self.target}" if self.moved == "lidar or target" else self.lidars[0]

    @property
    def per_30_days(self) -> tuple[Vector, Vector] | None:
        """The rate of a creep, translation (m) and rotation (rad); None for a jump."""
        if self.kind == "jump":
            return None
        share = _RATE_DAYS * _NS_PER_DAY / (self.last_time_ns - self.last_before_time_ns)
        x, y, z, *rotation_rad = (share * value for value in (*self.translation_m, *self.rotation_rad))
        return (x, y, z), (rotation_rad[0], rotation_rad[1], rotation_rad[2])

    @property
    def period_ns(self) -> tuple[int, int]:
        """From the last log before a jump to the first one after it, or from the first to the last log of a creep."""
        return self.last_before_time_ns, self.last_time_ns

    @property
    def when(self) -> str:
        """The days of it, for people."""
        return day_of(self.time_ns) if self.kind == "jump" else f"since {day_of(self.last_before_time_ns)}"

    @property
    def size(self) -> tuple[float, float]:
        """The lengths of the translation (mm) and of the rotation (deg)."""
        return _lengths(self.translation_m, self.rotation_rad)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sentence(self) -> str:
        """The event in one sentence, for people; dates are UTC."""
        first = _date(self.last_before_time_ns, self.time_ns)
        if (rate := self.per_30_days) is not None:
            return f"{self.vehicle}: {self.part} creeps by {_motion(*rate)} per 30 days since {first}."
        then = _date(self.time_ns, self.last_before_time_ns)
        motion = _motion(self.translation_m, self.rotation_rad)
        return f"{self.vehicle}: {self.part} moved by {motion} between {first} and {then}."


class FleetOffset(BaseModel, frozen=True):
    """A LiDAR that is elsewhere than its reference.

    Attributes:
        scope: the whole fleet against the nominal pose (a wrong CAD value), one vehicle against the fleet, or, of fewer
            than three vehicles, one against the nominal pose.
        vehicle: that vehicle; None for the fleet.
        vehicles: number of vehicles that have the LiDAR.
        translation_m, rotation_rad: from the reference to where it is, along the target's axes.
        p_value: share of LiDARs within the tolerance of assembly that seem to be as far off.
    """

    kind: ClassVar[str] = "offset"
    when: ClassVar[str] = ""
    period_ns: ClassVar[None] = None
    lidar: str
    target: str = Field(exclude=True)
    scope: OffsetScope
    vehicle: str | None
    vehicles: int
    translation_m: Vector
    rotation_rad: _RotationRad = Field(serialization_alias="rotation_deg")
    p_value: float

    @property
    def part(self) -> str:
        """The LiDAR."""
        return self.lidar

    @property
    def size(self) -> tuple[float, float]:
        """The lengths of the translation (mm) and of the rotation (deg)."""
        return _lengths(self.translation_m, self.rotation_rad)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sentence(self) -> str:
        """The offset in one sentence, for people."""
        motion = _motion(self.translation_m, self.rotation_rad)
        if self.scope == "fleet":
            return f"{self.lidar} is {motion} off its nominal pose on all {self.vehicles} vehicles."
        reference = f"the fleet of {self.vehicles} vehicles" if self.scope == "vehicle" else "its nominal pose"
        return f"{self.vehicle}: {self.lidar} is {motion} off {reference}."


class Outage(BaseModel, frozen=True):
    """A LiDAR without a pose in two or more logs in a row.

    Attributes:
        reason: stable name of the cause in the last of them.
        key, time_ns: of the first of these logs.
        last_time_ns: time of the last of them.
        logs: number of them.
        lasts: whether its last log is one of them.
    """

    kind: ClassVar[str] = "lost"
    size: ClassVar[None] = None
    vehicle: str
    lidar: str
    reason: str
    key: str = Field(serialization_alias="first_log")
    time_ns: _TimeNs = Field(serialization_alias="first_time")
    last_time_ns: _TimeNs = Field(serialization_alias="last_time")
    logs: int
    lasts: bool

    @property
    def part(self) -> str:
        """The LiDAR."""
        return self.lidar

    @property
    def period_ns(self) -> tuple[int, int]:
        """The times of its first and its last log."""
        return self.time_ns, self.last_time_ns

    @property
    def when(self) -> str:
        """The days of it, for people."""
        first = day_of(self.time_ns)
        return f"since {first}" if self.lasts else f"{first} to {day_of(self.last_time_ns)}"

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sentence(self) -> str:
        """The outage in one sentence, for people; dates are UTC."""
        cause = _CAUSES.get(self.reason, f"is not placed ({self.reason.replace('_', ' ')})")
        return f"{self.vehicle}: {self.lidar} {cause} {self.when}, in {self.logs} logs."


Finding = DriftEvent | FleetOffset | Outage


def drift_document(
    events: Sequence[DriftEvent], offsets: Sequence[FleetOffset], outages: Sequence[Outage]
) -> dict[str, Any]:
    """Return plain values: times in ISO 8601, lengths in metres, angles in degrees, along the target's axes."""
    found = {"moved": events, "offset": offsets, "lost": outages}
    document = {name: [each.model_dump(mode="json", by_alias=True) for each in own] for name, own in found.items()}
    return {"schema": "multilica/drift/1", **document}


def _lengths(translation_m: Vector, rotation_rad: Vector) -> tuple[float, float]:
    return 1e3 * float(np.linalg.norm(translation_m)), float(np.rad2deg(np.linalg.norm(rotation_rad)))


def _motion(translation_m: Vector, rotation_rad: Vector) -> str:
    length_mm, angle_deg = _lengths(translation_m, rotation_rad)
    return f"{length_mm:.{0 if length_mm >= 10.0 else 1}f} mm and {angle_deg:.2f} deg"


def _date(time_ns: int, other_ns: int) -> str:
    """Return the day of a time, with the time of day if the other time is on the same day."""
    one, other = moment(time_ns), moment(other_ns)
    return f"{one:%Y-%m-%d %H:%M}" if one.date() == other.date() else f"{one:%Y-%m-%d}"
