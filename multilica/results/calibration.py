# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration, over one snapshot or several, and its tables for data frames and notebooks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from math import degrees, isfinite
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from multilica.errors import escape_controls
from multilica.geometry import RigidTransform
from multilica.optional_libraries import needed_for
from multilica.results.clouds import SensorHealth
from multilica.results.placements import GroundPlane, LidarPlacement, MergeDecision, Refinement
from multilica.results.registrations import PairRegistration, weakest_deviations
from multilica.results.stops import Knock, StopLink, StopMotion, StopPose
from multilica.results.values import Figure

if TYPE_CHECKING:
    import pandas as pd

LEVEL_FRAME = "level"

Status = Literal["complete", "partial", "failed"]

_VECTORS = {
    "xyz_m": ("x_m", "y_m", "z_m"),
    "quaternion_xyzw": ("qx", "qy", "qz", "qw"),
    "rpy_deg": ("roll_deg", "pitch_deg", "yaw_deg"),
    "sigma_xyz_m": ("sigma_x_m", "sigma_y_m", "sigma_z_m"),
    "sigma_rotation_deg": ("sigma_about_x_deg", "sigma_about_y_deg", "sigma_about_z_deg"),
}
"""Columns of the vectors of a pose and of its standard deviations."""
TABLE_COLUMNS = ("lidar", "target", "status", *sum(_VECTORS.values(), ()), "fitness", "rmse_m", "reason")

_HEAD = ("LiDAR", "status", "x m", "y m", "z m", "roll deg", "pitch deg", "yaw deg", "sigma mm", "sigma deg", "fitness")
# Colours are those of the notebook, so that it reads in the light and in the dark.
_CELL = "padding:0.2em 0.6em;border-bottom:1px solid rgba(128,128,128,0.4);background:none;color:inherit"
_LEFT, _RIGHT = f"{_CELL};text-align:left", f"{_CELL};text-align:right"
_NAME = f"{_LEFT};white-space:nowrap"
_UNKNOWN = "-"


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
    probability: Annotated[
        Figure | None,
        Field(
            description="Probability that correct poses differ by as much as this one and another snapshot's, the "
            "least over all others. Chi squared with 6 degrees of freedom; null without others."
        ),
    ] = None
    contradicts: Annotated[
        tuple[str, ...], Field(description="Snapshots for which it is below one in a thousand: a sigma is too small.")
    ] = ()

    @property
    def text(self) -> str:
        """Distance and angle as text."""
        return f"{1000.0 * self.distance_m:.1f} mm, {self.angle_deg:.3f} deg"


@dataclass(frozen=True, slots=True)
class SnapshotReport:
    """The contribution of one snapshot to a joint result."""

    name: Annotated[str, Field(description="Name of the snapshot.")]
    source: Annotated[str, Field(description="Name of the file, or address.")]
    sha256: Annotated[str, Field(description="Hash of the file; empty if it is not known.")]
    refusal: Annotated[str | None, Field(description="Reason why the snapshot was left out; null if it was used.")] = (
        None
    )
    outliers: Annotated[tuple[str, ...], Field(description="LiDARs on which other snapshots outvoted this one.")] = ()
    disputed: Annotated[
        tuple[str, ...], Field(description="LiDARs on which it contradicts other snapshots without a majority.")
    ] = ()
    deviations: Annotated[tuple[SnapshotDeviation, ...], Field(description="Per LiDAR that it places.")] = ()

    @property
    def contradicting(self) -> tuple[SnapshotDeviation, ...]:
        """Those beyond the covariances that count all the same, as the snapshots differ by little."""
        apart = {*self.outliers, *self.disputed}
        return tuple(each for each in self.deviations if each.contradicts and each.lidar not in apart)

    @property
    def text(self) -> str:
        """The outcome of the snapshot as text."""
        if self.refusal:
            return f"left out: {self.refusal}"
        parts = [
            f"OUTLIER: {each.lidar} is off by {each.text} from the other snapshots"
            for each in self.deviations
            if each.outlier
        ]
        parts += [f"contradicts other snapshots on {lidar}, without a majority" for lidar in self.disputed]
        parts += [
            f"differs from {' and '.join(each.contradicts)} on {each.lidar} by more than their sigmas allow, with "
            f"probability {max(each.probability or 0.0, 1e-300):.0e}: the joint sigma counts this scatter"
            for each in self.contradicting
        ]
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
    unlinked_stops: Annotated[
        tuple[tuple[str, str], ...], Field(description="Pairs of stops between which further links could be.")
    ] = ()


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """The outcome; fields that `ResultDocument` has as well are described there.

    Args:
        placements: per LiDAR in name order, the target with the identity.
        pairs: registrations of all pairs that were tried, in name order.
        health: of each LiDAR that was examined, in name order.
        trusted: the registrations that the poses rest on: accepted pairs, with merges that joined what none of them do.
        stops: the vehicle at each stop that links connect with others; empty without links.
        links: registrations between stops, also those that are not used.
        knocks: LiDARs that moved on the vehicle between two stops.
        motions: of LiDARs between stops by odometry, also those that are not used.
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
    stops: tuple[StopPose, ...] = ()
    links: tuple[StopLink, ...] = ()
    knocks: tuple[Knock, ...] = ()
    motions: tuple[StopMotion, ...] = ()
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

        The columns are those of `multilica.results.calibration.TABLE_COLUMNS`: `T_target_source` in metres, as unit
        quaternion and as roll, pitch and yaw in degrees (extrinsic xyz), standard deviations in metres and degrees, all
        along and about the axes of the target, fitness (0 to 1), RMSE in metres, and the pair that placed the LiDAR or
        the reason why it is uncertain or not placed. Numbers that are not known are NaN.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        with needed_for("`to_dataframe`", "pandas"):
            import pandas as pd
        return pd.DataFrame(table_rows(self), columns=TABLE_COLUMNS)

    def _repr_html_(self) -> str:
        """Return the table that notebooks show."""
        return html_table(self)

    def __getitem__(self, lidar: str) -> LidarPlacement:
        """Return the placement of that LiDAR; KeyError if the rig has none of that name."""
        for placement in self.placements:
            if placement.lidar == lidar:
                return placement
        raise KeyError(lidar)


def table_rows(result: CalibrationResult) -> list[dict[str, str | float]]:
    """Return a row per LiDAR with the keys of `TABLE_COLUMNS`."""
    return [_row(placement, result.target) for placement in result.placements]


def _row(placement: LidarPlacement, target: str) -> dict[str, str | float]:
    is_target, nan = placement.lidar == target, float("nan")
    status = "target" if is_target and placement.placed else placement.status
    row: dict[str, str | float] = {"lidar": placement.lidar, "target": target, "status": status}
    for name, columns in _VECTORS.items():
        values = getattr(placement if name.startswith("sigma") else placement.T_target_source, name, None)
        row |= dict.fromkeys(columns, nan) if values is None else zip(columns, (values + 0.0).tolist(), strict=True)
    registered = not is_target and isfinite(placement.rmse_m)
    row["fitness"], row["rmse_m"] = (placement.fitness, placement.rmse_m) if registered else (nan, nan)
    return {**row, "reason": placement.reason}


def html_table(result: CalibrationResult) -> str:
    """Return a table with the extrinsics, their largest standard deviations, and why a LiDAR has no certain pose."""
    caption = f"T_target_source, target {_text(result.target)}: {result.status}"
    head = "".join(_cell("th", name, _LEFT if index < 2 else _RIGHT) for index, name in enumerate(_HEAD))
    body = "".join(_html_rows(row, _sigmas(result[str(row["lidar"])])) for row in table_rows(result))
    return (
        f'<table style="border-collapse:collapse;color:inherit"><caption style="{_LEFT}">{caption}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _sigmas(placement: LidarPlacement) -> tuple[float, float]:
    """Return the standard deviations (mm, deg) in the weakest directions; NaN where they are not known."""
    if placement.covariance is None:
        return float("nan"), float("nan")
    sigma_m, sigma_rad = weakest_deviations(placement.covariance)
    return 1e3 * sigma_m, degrees(sigma_rad)


def _html_rows(row: Mapping[str, str | float], sigmas: tuple[float, float]) -> str:
    known = row["status"] != "target"
    cells = (
        *(_number(float(row[name]), 3) for name in ("x_m", "y_m", "z_m")),
        *(_number(float(row[name]), 2) for name in ("roll_deg", "pitch_deg", "yaw_deg")),
        _number(sigmas[0], 1) if known else _UNKNOWN,
        _number(sigmas[1], 3) if known else _UNKNOWN,
        _number(float(row["fitness"]), 3),
    )
    status = str(row["status"]).replace("_", " ")
    doubtful = row["status"] in ("uncertain", "not_placed")
    named = _cell("th", _text(row["lidar"]), _NAME) + _cell("td", f"<b>{status}</b>" if doubtful else status, _NAME)
    line = f"<tr>{named}{''.join(_cell('td', cell, _RIGHT) for cell in cells)}</tr>"
    if not doubtful:
        return line
    return f'{line}<tr><td></td><td colspan="{len(_HEAD) - 1}" style="{_LEFT}">{_text(row["reason"])}</td></tr>'


def _cell(tag: str, content: str, style: str) -> str:
    return f'<{tag} style="{style}">{content}</{tag}>'


def _number(value: float, digits: int) -> str:
    return f"{value:z.{digits}f}" if isfinite(value) else _UNKNOWN


def _text(value: object) -> str:
    return escape(escape_controls(str(value)))
