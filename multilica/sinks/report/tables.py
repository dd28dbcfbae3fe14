# SPDX-License-Identifier: Apache-2.0
"""Tables of a report."""

from collections.abc import Iterable
from dataclasses import dataclass

from multilica.results.document import LidarEntry, PairEntry, SnapshotEntry
from multilica.sinks.report.contents import ReportContents

__all__ = [
    "MatrixCell",
    "PairRow",
    "ResultRow",
    "SnapshotRow",
    "StageRow",
    "matrix_rows",
    "pair_rows",
    "result_rows",
    "snapshot_rows",
    "stage_rows",
]

_NONE = "-"


@dataclass(frozen=True, slots=True)
class ResultRow:
    """A LiDAR of the rig; all cells as text.

    Args:
        pose: x, y, z in metres, roll, pitch, yaw in degrees.
        quality: largest sigma in mm and in degrees, fitness, RMSE in mm.
    """

    lidar: str
    status: str
    pose: tuple[str, ...]
    quality: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MatrixCell:
    """A pair in the matrix; empty if it was not registered this way round."""

    text: str = ""
    outcome: str = ""


@dataclass(frozen=True, slots=True)
class PairRow:
    """A registered pair; `figures` are fitness, RMSE in mm, and points that agree, violate, are occluded."""

    target: str
    source: str
    outcome: str
    figures: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StageRow:
    """The time of a stage, also as a share of the slowest."""

    stage: str
    seconds: str
    share: float


@dataclass(frozen=True, slots=True)
class SnapshotRow:
    """A snapshot of a joint result; `off` is its largest deviation in mm and in degrees."""

    name: str
    source: str
    verdict: str
    off: tuple[str, str]


def result_rows(contents: ReportContents) -> list[ResultRow]:
    """Return a row per LiDAR."""
    return [_result_row(name, entry, contents.target) for name, entry in contents.document.lidars.items()]


def _result_row(name: str, entry: LidarEntry, target: str) -> ResultRow:
    if entry.xyz_m is None or entry.rpy_deg is None:
        return ResultRow(name, "not placed", (_NONE,) * 6, (_NONE,) * 4)
    pose = (*(f"{value:z.3f}" for value in entry.xyz_m), *(f"{value:z.2f}" for value in entry.rpy_deg))
    if name == target:
        return ResultRow(name, "target", pose, (_NONE,) * 4)
    quality = (
        _number(_largest(entry.sigma_xyz_m), 1e3, 1),
        _number(_largest(entry.sigma_rotation_deg), 1.0, 3),
        _number(entry.fitness, 1.0, 3),
        _number(entry.rmse_m, 1e3, 1),
    )
    return ResultRow(name, "placed", pose, quality)


def _largest(values: Iterable[float] | None) -> float | None:
    return None if values is None else max(values)


def _number(value: float | None, scale: float, digits: int) -> str:
    return _NONE if value is None else f"{scale * value:z.{digits}f}"


def matrix_rows(contents: ReportContents) -> list[tuple[str, list[MatrixCell]]]:
    """Return per target a cell per source."""
    cells = {
        pair.key: MatrixCell(_number(pair.fitness, 1.0, 2), pair.verdict.outcome) for pair in contents.document.pairs
    }
    names = contents.names
    return [(target, [cells.get((target, source), MatrixCell()) for source in names]) for target in names]


def pair_rows(contents: ReportContents) -> list[PairRow]:
    """Return a row per registered pair, the accepted ones last."""
    rows = [_pair_row(pair) for pair in contents.document.pairs]
    return sorted(rows, key=lambda row: row.outcome == "accept")


def _pair_row(pair: PairEntry) -> PairRow:
    best = pair.registrations[0] if pair.registrations else None
    counts = () if best is None else (best.agree, best.violate, best.occluded)
    points = tuple(f"{count:,}" for count in counts) or (_NONE,) * 3
    return PairRow(
        pair.target,
        pair.source,
        pair.verdict.outcome,
        (_number(pair.fitness, 1.0, 3), _number(pair.rmse_m, 1e3, 1), *points),
        tuple(reason.text for reason in pair.verdict.reasons),
    )


def stage_rows(contents: ReportContents) -> list[StageRow]:
    """Return a row per timed stage."""
    known = {stage: seconds for stage, seconds in contents.document.timing_s.items() if seconds is not None}
    slowest = max([*known.values(), 1e-9])
    return [StageRow(stage, f"{seconds:.2f}", seconds / slowest) for stage, seconds in known.items()]


def snapshot_rows(contents: ReportContents) -> list[SnapshotRow]:
    """Return a row per snapshot of a joint result."""
    return [_snapshot_row(snapshot) for snapshot in contents.document.snapshots]


def _snapshot_row(snapshot: SnapshotEntry) -> SnapshotRow:
    verdicts = [f"left out: {snapshot.refusal}"] if snapshot.refusal else []
    verdicts += [f"outvoted on {lidar}" for lidar in snapshot.outliers]
    verdicts += [f"contradicts others on {lidar} (undecided)" for lidar in snapshot.disputed]
    off = max(snapshot.deviations, key=lambda deviation: deviation.distance_m, default=None)
    figures = (_NONE, _NONE) if off is None else (f"{1e3 * off.distance_m:z.1f}", f"{off.angle_deg:z.3f}")
    return SnapshotRow(snapshot.name, snapshot.source, "; ".join(verdicts) or "agrees", figures)
