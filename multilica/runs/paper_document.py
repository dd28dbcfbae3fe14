# SPDX-License-Identifier: Apache-2.0
"""The paper's table as JSON."""

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field

from multilica.results.document.values import Entry, Number
from multilica.runs.evaluation import LeftOut
from multilica.runs.paper_table import AxisError, PaperSummary, PaperTable


class AxisErrorEntry(Entry):
    """Errors along the target's axes and about the source's; null if nothing was placed."""

    x_m: Number = None
    y_m: Number = None
    z_m: Number = None
    roll_deg: Number = None
    pitch_deg: Number = None
    yaw_deg: Number = None
    angle_deg: Number = None


class PaperRow(AxisErrorEntry):
    """One LiDAR relative to another in one run."""

    run: str
    target: str
    source: str
    success: bool


class PaperSummaryEntry(Entry):
    """Figures over scenes; `lidar` is null for pairs, `pair` for LiDARs, both for all."""

    lidar: str | None = None
    pair: tuple[str, str] | None = None
    poses: int
    placed: int
    successes: int
    placed_rate: Number
    success_rate: Number
    rmse: AxisErrorEntry


class PaperDocument(Entry):
    """The output of `multilica evaluate --table paper --json`; null stands for what is not known."""

    schema_: Literal["multilica/paper-table/1"] = Field("multilica/paper-table/1", alias="schema")
    within_m: float
    within_deg: float
    to_target: PaperSummaryEntry
    by_lidar: tuple[PaperSummaryEntry, ...]
    between: PaperSummaryEntry
    by_pair: tuple[PaperSummaryEntry, ...]
    rows: tuple[PaperRow, ...]
    between_rows: tuple[PaperRow, ...]
    left_out: tuple[LeftOut, ...]


def paper_document(table: PaperTable) -> PaperDocument:
    """Convert the paper's table to its JSON document."""
    limits = table.evaluation.tolerances
    return PaperDocument(
        within_m=limits.within_m,
        within_deg=math.degrees(limits.within_rad),
        to_target=_summary(table.overall),
        by_lidar=tuple(_summary(summary, lidar=lidar) for lidar, summary in table.by_lidar.items()),
        between=_summary(table.overall_between),
        by_pair=tuple(_summary(summary, pair=pair) for pair, summary in table.by_pair.items()),
        rows=tuple(PaperRow.of(one, **_values(one.error)) for one in table.to_target),
        between_rows=tuple(PaperRow.of(one, **_values(one.error)) for one in table.between),
        left_out=table.evaluation.left_out,
    )


def _summary(summary: PaperSummary, **names: object) -> PaperSummaryEntry:
    return PaperSummaryEntry.of(summary, rmse=AxisErrorEntry(**_values(summary.rmse)), **names)


def _values(error: AxisError | None) -> dict[str, Any]:
    if error is None:
        return {}
    values = [*error.translation_m, *np.rad2deg(error.rotation_rad), math.degrees(error.angle_rad)]
    return dict(zip(AxisErrorEntry.model_fields, values, strict=True))
