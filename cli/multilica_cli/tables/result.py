# SPDX-License-Identifier: Apache-2.0
"""Tables of a calibration result."""

from __future__ import annotations

from collections.abc import Iterable
from math import degrees
from typing import TYPE_CHECKING

from multilica_cli.tables.folding_table import FoldingTable, number_cells, size_cells
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.extrinsics import Extrinsics
    from multilica.geometry import RigidTransform
    from multilica.results.document import LidarEntry, ResultDocument
    from multilica.results.document.lidars import SpreadEntry
    from multilica.run import CalibrationRun

_PRIOR_COLUMNS = ("to prior\nmm", "to prior\ndeg")
_STATUS = {"placed": "placed", "uncertain": "UNCERTAIN", "not_placed": "NOT PLACED"}
_SPREAD_COLUMNS = ("spread\nmm", "spread\ndeg", "snap-\nshots")
POSE_COLUMNS = ("x\nm", "y\nm", "z\nm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg")


def pose_cells(pose: RigidTransform | LidarEntry | None) -> tuple[str, ...]:
    """Format a pose for `POSE_COLUMNS`."""
    if pose is None or pose.xyz_m is None or pose.rpy_deg is None:
        return ("-",) * len(POSE_COLUMNS)
    return *number_cells(pose.xyz_m, 1.0, 3), *number_cells(pose.rpy_deg, 1.0, 2)


def print_run(run: CalibrationRun, truth: Extrinsics | None = None, *, quiet: bool) -> None:
    """Print the extrinsics, the errors if the truth is known, the files, and why a LiDAR is missing or doubtful."""
    from multilica.diagnosis import explain
    from multilica.runs.run_documents import read_run_document

    console, result = stdout_console(quiet=quiet), run.result
    document = read_run_document(run.directory).document
    print_placements(document, console)
    if any(place.T_target_source is not None and place.lidar != result.target for place in result.placements):
        console.print(f"target {result.target}: {result.target_reason}")
    if result.ground is not None:
        console.print(f"ground, frame {result.ground.frame}: {result.ground.text}")
    if truth is not None:
        console.print(_truth_table(document, truth))
    for snapshot in result.snapshots:
        console.print(f"snapshot {snapshot.name}: {snapshot.text}")
    for path in run.written:
        console.print(f"wrote {path}")
    for line in explain(document).findings:
        console.print(line)


def print_placements(document: ResultDocument, console: Console) -> None:
    """Tabulate the pose of each LiDAR in the target's frame; nothing before there are poses."""
    lidars = document.lidars
    if not any(entry.xyz_m for entry in lidars.values()):
        return
    prior = any(entry.prior is not None for entry in lidars.values())
    columns = ["LiDAR", "status", *POSE_COLUMNS, "sigma\nmm", "sigma\ndeg", "fitness"]
    columns += _PRIOR_COLUMNS if prior else ()
    columns += _SPREAD_COLUMNS if document.snapshots else ()
    title = f"T_target_source, target {document.target}"
    table = FoldingTable(title, columns, numbers_from=2, spare=("fitness",))
    for name, entry in lidars.items():
        is_target = name == document.target
        status = "target" if is_target else _STATUS[entry.status]
        scores: tuple[str, ...] = ("-",) * 3
        if entry.xyz_m is not None and not is_target:
            fitness = number_cells((entry.fitness,), 1.0, 3)
            scores = (*_largest(entry.sigma_xyz_m, entry.sigma_rotation_deg), *fitness)
        cells = (name, status, *pose_cells(entry), *scores)
        if prior:
            compared = None if is_target else entry.prior
            cells += ("-", "-") if compared is None else size_cells(compared.deviation_m, compared.deviation_deg)
        table.add_row(*cells, *(_spread(entry.spread) if document.snapshots else ()))
    console.print(table)


def _truth_table(document: ResultDocument, truth: Extrinsics) -> FoldingTable:
    """Tabulate each pose with its true pose and the distance between the two."""
    table = FoldingTable(
        "Ground truth", ("LiDAR", "", *POSE_COLUMNS, "error\nmm", "error\ndeg"), numbers_from=2, keys=2
    )
    for name in document.lidars:
        if name == document.target:
            continue
        found, true = document.poses.get(name), truth.between(document.target, name)
        table.add_row(name, "found", *pose_cells(found))
        error_m, error_rad = (None, None) if found is None else true.distance_to(found)
        error = size_cells(error_m, None if error_rad is None else degrees(error_rad))
        table.add_row("", "true", *pose_cells(true), *error, end_section=True)
    return table


def _spread(spread: SpreadEntry | None) -> tuple[str, ...]:
    """Return the standard deviations over the snapshots of the worst axes, and the number of snapshots."""
    return ("-", "-", "-") if spread is None else (*_largest(spread.xyz_m, spread.rotation_deg), str(spread.snapshots))


def _largest(xyz_m: Iterable[float] | None, rotation_deg: Iterable[float] | None) -> tuple[str, ...]:
    return size_cells(*(None if values is None else max(values) for values in (xyz_m, rotation_deg)))
