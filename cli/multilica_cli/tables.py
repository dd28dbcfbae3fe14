# SPDX-License-Identifier: Apache-2.0
"""Results as tables for people."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.results import CalibrationResult, LidarPlacement

__all__ = ["POSE_COLUMNS", "placements_table", "plain_table", "truth_table"]


_PRIOR_COLUMNS = ("off prior\nmm", "off prior\ndeg")
_SPREAD_COLUMNS = ("spread\nmm", "spread\ndeg", "snap-\nshots")
POSE_COLUMNS = ("x\nm", "y\nm", "z\nm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg")


def plain_table(title: str, columns: Iterable[str], *, numbers_from: int = 1) -> Table:
    """A table without colours; columns from the given one on hold numbers."""
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        header_style="bold",
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index >= numbers_from else "left", no_wrap=True)
    return table


def placements_table(result: CalibrationResult) -> Table:
    """Where each LiDAR sits in the target's frame."""
    prior = any(placement.T_target_source_prior is not None for placement in result.placements)
    columns = ["LiDAR", "status", *POSE_COLUMNS, "sigma\nmm", "sigma\ndeg", "fitness"]
    columns += _PRIOR_COLUMNS if prior else ()
    columns += _SPREAD_COLUMNS if result.snapshots else ()
    table = plain_table(f"T_target_source, target {result.target}", columns, numbers_from=2)
    for placement in result.placements:
        table.add_row(
            placement.lidar,
            _status(placement, result.target),
            *_pose(placement),
            *_scores(placement, result.target),
            *(_off_prior(placement, result.target) if prior else ()),
            *(_spread(placement) if result.snapshots else ()),
        )
    return table


def truth_table(result: CalibrationResult, truth: Extrinsics) -> Table:
    """Each placed LiDAR beside its true pose, with the distance between the two."""
    columns = ("LiDAR", "", *POSE_COLUMNS, "off by\nmm", "off by\ndeg")
    table = plain_table("Found beside true", columns, numbers_from=2)
    for placement in result.placements:
        if placement.lidar == result.target:
            continue
        true_pose = truth.between(result.target, placement.lidar)
        table.add_row(placement.lidar, "found", *_pose(placement), "", "")
        error = (
            ("", "")
            if placement.T_target_source is None
            else _difference(*true_pose.distance_to(placement.T_target_source))
        )
        table.add_row(
            "", "true", *_numbers(true_pose.xyz_m, 3), *_numbers(true_pose.rpy_deg, 2), *error, end_section=True
        )
    return table


def _status(placement: LidarPlacement, target: str) -> str:
    if placement.lidar == target:
        return "target"
    return "placed" if placement.placed else "NOT PLACED"


def _pose(placement: LidarPlacement) -> tuple[str, ...]:
    pose = placement.T_target_source
    return ("-",) * 6 if pose is None else (*_numbers(pose.xyz_m, 3), *_numbers(pose.rpy_deg, 2))


def _scores(placement: LidarPlacement, target: str) -> tuple[str, str, str]:
    """The largest standard deviations over the axes, then the fitness."""
    if placement.lidar == target or not placement.placed:
        return "-", "-", "-"
    sigma_xyz_m, sigma_rotation_deg = placement.sigma_xyz_m, placement.sigma_rotation_deg
    if sigma_xyz_m is None or sigma_rotation_deg is None:
        return "-", "-", f"{placement.fitness:.3f}"
    return f"{1000.0 * max(sigma_xyz_m):.1f}", f"{max(sigma_rotation_deg):.3f}", f"{placement.fitness:.3f}"


def _off_prior(placement: LidarPlacement, target: str) -> tuple[str, str]:
    if placement.lidar == target or placement.prior_deviation is None:
        return "-", "-"
    return _difference(*placement.prior_deviation)


def _spread(placement: LidarPlacement) -> tuple[str, ...]:
    """The largest standard deviations over the axes, and over how many snapshots."""
    spread = placement.spread
    if spread is None or spread.xyz_m is None or spread.rotation_deg is None:
        return "-", "-", "-" if spread is None else str(spread.snapshots)
    return f"{1000.0 * max(spread.xyz_m):.1f}", f"{max(spread.rotation_deg):.3f}", str(spread.snapshots)


def _numbers(values: Iterable[float], digits: int) -> tuple[str, ...]:
    return tuple(f"{value:z.{digits}f}" for value in values)


def _difference(translation_m: float, rotation_rad: float) -> tuple[str, str]:
    from math import degrees

    return f"{1000.0 * translation_m:.1f}", f"{degrees(rotation_rad):.3f}"
