# SPDX-License-Identifier: Apache-2.0
"""A result as a table of HTML for notebooks, and as rows for data frames."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from math import isfinite
from typing import TYPE_CHECKING

from multilica.errors import escape_controls
from multilica.geometry import FloatArray

if TYPE_CHECKING:
    from multilica.results.calibration import CalibrationResult
    from multilica.results.placements import LidarPlacement

TABLE_COLUMNS: Mapping[str, str] = {
    "lidar": "name of the LiDAR",
    "target": "name of the target LiDAR, whose axes all poses refer to",
    "status": "target, placed, uncertain or not_placed",
    "x_m": "position in the target frame, metres",
    "y_m": "the same",
    "z_m": "the same",
    "qx": "rotation T_target_source as a unit quaternion",
    "qy": "the same",
    "qz": "the same",
    "qw": "the same",
    "roll_deg": "the same rotation about the fixed axes of the target, extrinsic xyz, degrees",
    "pitch_deg": "the same",
    "yaw_deg": "the same",
    "sigma_x_m": "standard deviation along the target's axes, metres",
    "sigma_y_m": "the same",
    "sigma_z_m": "the same",
    "sigma_about_x_deg": "standard deviation about the target's axes, degrees",
    "sigma_about_y_deg": "the same",
    "sigma_about_z_deg": "the same",
    "fitness": "share of the points that lie near a surface of the target cloud, 0 to 1",
    "rmse_m": "RMS distance of those points to their nearest target point, metres",
    "reason": "the pair that placed it, or the reason why it is uncertain or not placed",
}
"""Name of each column -> its meaning; numbers are NaN where they are not known."""

_HEAD = ("LiDAR", "status", "x m", "y m", "z m", "roll deg", "pitch deg", "yaw deg", "sigma mm", "sigma deg", "fitness")
# Colours are those of the notebook, so that it reads in the light and in the dark.
_CELL = "padding:0.2em 0.6em;border-bottom:1px solid rgba(128,128,128,0.4);background:none;color:inherit"
_LEFT, _RIGHT = f"{_CELL};text-align:left", f"{_CELL};text-align:right"
_NAME = f"{_LEFT};white-space:nowrap"
_UNKNOWN = "-"


def table_rows(result: CalibrationResult) -> list[dict[str, str | float]]:
    """Return a row per LiDAR with the keys of `TABLE_COLUMNS`."""
    return [_row(placement, result.target) for placement in result.placements]


def _row(placement: LidarPlacement, target: str) -> dict[str, str | float]:
    pose, is_target = placement.T_target_source, placement.lidar == target
    numbers = (
        *_numbers(None if pose is None else pose.xyz_m, 3),
        *_numbers(None if pose is None else pose.quaternion_xyzw, 4),
        *_numbers(None if pose is None else pose.rpy_deg, 3),
        *_numbers(placement.sigma_xyz_m, 3),
        *_numbers(placement.sigma_rotation_deg, 3),
        *_scores(placement, target),
    )
    values = (placement.lidar, target, "target" if is_target and placement.placed else placement.status, *numbers)
    return dict(zip(TABLE_COLUMNS, (*values, placement.reason), strict=True))


def _numbers(values: FloatArray | None, count: int) -> list[float]:
    return [float("nan")] * count if values is None else (values + 0.0).tolist()


def _scores(placement: LidarPlacement, target: str) -> tuple[float, float]:
    """Return fitness and RMSE, NaN where there was no registration."""
    if placement.lidar == target or not isfinite(placement.rmse_m):
        return float("nan"), float("nan")
    return placement.fitness, placement.rmse_m


def html_table(result: CalibrationResult) -> str:
    """Return a table with the extrinsics, their largest standard deviations, and why a LiDAR has no certain pose."""
    caption = f"T_target_source, target {_text(result.target)}: {result.status}"
    head = "".join(_cell("th", name, _LEFT if index < 2 else _RIGHT) for index, name in enumerate(_HEAD))
    body = "".join(_html_rows(row) for row in table_rows(result))
    return (
        f'<table style="border-collapse:collapse;color:inherit"><caption style="{_LEFT}">{caption}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _html_rows(row: Mapping[str, str | float]) -> str:
    sigmas_mm = [1e3 * float(row[f"sigma_{axis}_m"]) for axis in "xyz"]
    sigmas_deg = [float(row[f"sigma_about_{axis}_deg"]) for axis in "xyz"]
    known = row["status"] != "target"
    cells = (
        *(_number(float(row[name]), 3) for name in ("x_m", "y_m", "z_m")),
        *(_number(float(row[name]), 2) for name in ("roll_deg", "pitch_deg", "yaw_deg")),
        _number(max(sigmas_mm), 1) if known else _UNKNOWN,
        _number(max(sigmas_deg), 3) if known else _UNKNOWN,
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
