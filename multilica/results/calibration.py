# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration, over one snapshot or several."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from multilica.geometry import RigidTransform
from multilica.optional_libraries import needed_for
from multilica.results.clouds import SensorHealth
from multilica.results.merging import MergeDecision, Refinement
from multilica.results.notebook import TABLE_COLUMNS, html_table, table_rows
from multilica.results.placements import GroundPlane, LidarPlacement
from multilica.results.registrations import PairRegistration

if TYPE_CHECKING:
    import pandas as pd

LEVEL_FRAME = "level"

Status = Literal["complete", "partial", "failed"]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Reason why the snapshot was not calibrated at all."""

    # moving_vehicle, too_few_lidars or blind_target
    code: Annotated[str, Field(description="Stable name, for programs.")]
    text: Annotated[str, Field(description="The reason for people.")]


@dataclass(frozen=True, slots=True)
class SnapshotDeviation:
    """Deviation of a LiDAR in one snapshot alone from its pose in the joint result."""

    lidar: Annotated[str, Field(description="Name of the LiDAR.")]
    distance_m: Annotated[float, Field(description="Distance.")]
    angle_deg: Annotated[float, Field(description="Angle.")]
    outlier: Annotated[bool, Field(description="True if other snapshots outvoted this one.")] = False

    @property
    def text(self) -> str:
        """Distance and angle as text."""
        return f"{1000.0 * self.distance_m:.1f} mm, {self.angle_deg:.3f} deg"


@dataclass(frozen=True, slots=True)
class SnapshotReport:
    """The contribution of one snapshot to a joint result."""

    name: Annotated[str, Field(description="Name of the snapshot.")]
    source: Annotated[str, Field(description="File or address.")]
    sha256: Annotated[str, Field(description="Hash of the file; empty if it is not known.")]
    refusal: Annotated[str | None, Field(description="Reason why the snapshot was left out; null if it was used.")] = (
        None
    )
    outliers: Annotated[tuple[str, ...], Field(description="LiDARs on which other snapshots outvoted this one.")] = ()
    disputed: Annotated[
        tuple[str, ...],
        Field(description="LiDARs on which it contradicts other snapshots without a majority."),
    ] = ()
    deviations: Annotated[tuple[SnapshotDeviation, ...], Field(description="Per LiDAR that it places.")] = ()

    @property
    def text(self) -> str:
        """The outcome of the snapshot as text."""
        if self.refusal:
            return f"left out: {self.refusal}"
        parts = [
            f"OUTLIER: {each.lidar} is off by {each.text} where the other snapshots agree"
            for each in self.deviations
            if each.outlier
        ]
        parts += [f"contradicts other snapshots on {lidar}, without a majority" for lidar in self.disputed]
        if parts:
            return "; ".join(parts)
        if not self.deviations:
            return "places no LiDAR relative to the target"
        largest = max(self.deviations, key=lambda deviation: deviation.distance_m)
        return f"agrees: {largest.lidar} is off most, by {largest.text}"


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """Searches left out because the time was over; equal runs may differ."""

    max_time_s: Annotated[float, Field(description="The limit, `runtime.max_time_s`.")]
    not_reached: Annotated[tuple[tuple[str, str], ...], Field(description="Pairs that could have placed a LiDAR.")]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """The outcome; fields that `ResultDocument` has as well are described there.

    Args:
        placements: per LiDAR in name order, the target with the identity.
        pairs: registrations of all pairs that were tried, in name order.
        health: of each LiDAR that was examined, in name order.
        trusted: the registrations that the poses rest on: accepted pairs, with merges that joined what none of them do.
        level: pose of the target in a frame with z up, for pictures; None without a ground plane.
    """

    target: str
    target_reason: str
    placements: tuple[LidarPlacement, ...]
    pairs: tuple[PairRegistration, ...] = ()
    decisions: tuple[MergeDecision, ...] = ()
    ground: GroundPlane | None = None
    timing_s: Mapping[str, float] = field(default_factory=dict)
    refinement: Refinement | None = None
    health: tuple[SensorHealth, ...] = ()
    refusal: Refusal | None = None
    trusted: tuple[PairRegistration, ...] = ()
    snapshots: tuple[SnapshotReport, ...] = ()
    level: RigidTransform | None = None
    ground_refusal: str = ""
    time_limit: TimeLimit | None = None

    @property
    def status(self) -> Status:
        """``complete`` if every LiDAR is placed, ``failed`` if none but the target has a pose."""
        if all(placement.placed for placement in self.placements):
            return "complete"
        return "partial" if len(self.poses) > 1 else "failed"

    @property
    def poses(self) -> dict[str, RigidTransform]:
        """``T_target_lidar`` of the LiDARs that have a pose, also an uncertain one."""
        return {each.lidar: each.T_target_source for each in self.placements if each.T_target_source is not None}

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row per LiDAR in name order.

        The columns are those of `multilica.results.notebook.TABLE_COLUMNS`: pose in metres, as quaternion and in
        degrees, standard deviations in metres and degrees, all along the axes of the target, then fitness, RMSE and
        reason. Numbers that are not known are NaN.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        with needed_for("`to_dataframe`", "pandas"):
            import pandas as pd
        return pd.DataFrame(table_rows(self), columns=[*TABLE_COLUMNS])

    def _repr_html_(self) -> str:
        """Return the table that notebooks show."""
        return html_table(self)

    def __getitem__(self, lidar: str) -> LidarPlacement:
        """Return the placement of that LiDAR; KeyError if the rig has none of that name."""
        for placement in self.placements:
            if placement.lidar == lidar:
                return placement
        raise KeyError(lidar)
