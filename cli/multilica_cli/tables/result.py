# SPDX-License-Identifier: Apache-2.0
"""Tables of a calibration result."""

from __future__ import annotations

from collections.abc import Iterable
from math import degrees
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.geometry import RigidTransform
    from multilica.results import CalibrationResult, LidarPlacement
    from multilica.run import CalibrationRun

__all__ = ["POSE_COLUMNS", "plain_table", "pose_cells", "print_run"]

_PRIOR_COLUMNS = ("to prior\nmm", "to prior\ndeg")
_STATUS = {"placed": "placed", "uncertain": "UNCERTAIN", "not_placed": "NOT PLACED"}
_SPREAD_COLUMNS = ("spread\nmm", "spread\ndeg", "snap-\nshots")
POSE_COLUMNS = ("x\nm", "y\nm", "z\nm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg")


def plain_table(title: str, columns: Iterable[str], *, numbers_from: int = 1) -> Table:
    """Create a table without colours; columns from the given one on hold numbers."""
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


def pose_cells(pose: RigidTransform | None) -> tuple[str, ...]:
    """Format a pose for `POSE_COLUMNS`."""
    if pose is None:
        return ("-",) * len(POSE_COLUMNS)
    return *(f"{value:z.3f}" for value in pose.xyz_m), *(f"{value:z.2f}" for value in pose.rpy_deg)


def print_run(run: CalibrationRun, truth: Extrinsics | None = None, *, quiet: bool) -> None:
    """Print the extrinsics, the errors if the truth is known, the files, and why a LiDAR is missing or doubtful."""
    from multilica.runs.run_documents import explain_run

    console, result = stdout_console(quiet=quiet), run.result
    console.print(_placements_table(result))
    if any(place.T_target_source is not None and place.lidar != result.target for place in result.placements):
        console.print(f"target {result.target}: {result.target_reason}")
    if result.ground is not None:
        console.print(f"ground, frame {result.ground.frame}: {result.ground.text}")
    if truth is not None:
        console.print(_truth_table(result, truth))
    for snapshot in result.snapshots:
        console.print(f"snapshot {snapshot.name}: {snapshot.text}")
    for path in run.written:
        console.print(f"wrote {path}")
    for line in explain_run(run.directory).findings:
        console.print(line)


def _placements_table(result: CalibrationResult) -> Table:
    """Tabulate the pose of each LiDAR in the target's frame."""
    prior = any(placement.T_target_source_prior is not None for placement in result.placements)
    columns = ["LiDAR", "status", *POSE_COLUMNS, "sigma\nmm", "sigma\ndeg", "fitness"]
    columns += _PRIOR_COLUMNS if prior else ()
    columns += _SPREAD_COLUMNS if result.snapshots else ()
    table = plain_table(f"T_target_source, target {result.target}", columns, numbers_from=2)
    for placement in result.placements:
        is_target = placement.lidar == result.target
        status = "target" if is_target else _STATUS[placement.status]
        scores = ("-",) * 3
        if placement.T_target_source is not None and not is_target:
            sigmas = _largest(placement.sigma_xyz_m, placement.sigma_rotation_deg)
            scores = (*sigmas, f"{placement.fitness:.3f}")
        cells = (placement.lidar, status, *pose_cells(placement.T_target_source), *scores)
        if prior:
            cells += _distance_cells(None if is_target else placement.prior_deviation)
        table.add_row(*cells, *(_spread(placement) if result.snapshots else ()))
    return table


def _truth_table(result: CalibrationResult, truth: Extrinsics) -> Table:
    """Tabulate each pose with its true pose and the distance between the two."""
    table = plain_table("Ground truth", ("LiDAR", "", *POSE_COLUMNS, "error\nmm", "error\ndeg"), numbers_from=2)
    for placement in result.placements:
        if placement.lidar == result.target:
            continue
        found, true = placement.T_target_source, truth.between(result.target, placement.lidar)
        table.add_row(placement.lidar, "found", *pose_cells(found))
        error = None if found is None else true.distance_to(found)
        table.add_row("", "true", *pose_cells(true), *_distance_cells(error), end_section=True)
    return table


def _spread(placement: LidarPlacement) -> tuple[str, str, str]:
    """Return the standard deviations over the snapshots of the worst axes, and the number of snapshots."""
    spread = placement.spread
    return ("-", "-", "-") if spread is None else (*_largest(spread.xyz_m, spread.rotation_deg), str(spread.snapshots))


def _largest(xyz_m: Iterable[float] | None, rotation_deg: Iterable[float] | None) -> tuple[str, str]:
    if xyz_m is None or rotation_deg is None:
        return "-", "-"
    return f"{1000.0 * max(xyz_m):.1f}", f"{max(rotation_deg):.3f}"


def _distance_cells(distance: tuple[float, float] | None) -> tuple[str, str]:
    """Format a distance in metres and an angle in radians."""
    return ("-", "-") if distance is None else (f"{1000.0 * distance[0]:.1f}", f"{degrees(distance[1]):.3f}")
