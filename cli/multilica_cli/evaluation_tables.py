# SPDX-License-Identifier: Apache-2.0
"""An evaluation as tables for people."""

from __future__ import annotations

from math import degrees
from os.path import commonpath
from pathlib import Path
from typing import TYPE_CHECKING

from multilica_cli.tables import plain_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from multilica.fleet.evaluation import Comparison, Evaluation, Summary
    from multilica.fleet.pose_error import PoseError

__all__ = ["print_evaluation"]

_ERROR_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "off by\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "off by\ndeg")
_WORDS = {
    "within": "within",
    "between": "between",
    "false_accept": "FALSE ACCEPT",
    "false_refuse": "FALSE REFUSE",
}
_MOST_ROWS = 40


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Errors per LiDAR, statistics, counts, and what was left out."""
    console.print(_detail_table(evaluation))
    console.print(_statistics_table(evaluation))
    console.print(_outcome_table(evaluation))
    runs, faultless = len(evaluation.compared_runs), len(evaluation.faultless_runs)
    console.print(f"runs with every compared LiDAR within: {faultless} of {runs}")
    targets = sorted({one.target for one in evaluation.comparisons})
    if len(targets) > 1:
        console.print(f"note: the axes are those of each run's own target: {', '.join(targets)}")
    for left_out in evaluation.left_out:
        what = left_out.run if left_out.lidar is None else f"{left_out.run}, LiDAR {left_out.lidar}"
        console.print(f"left out: {what}: {left_out.reason}")


def _detail_table(evaluation: Evaluation) -> Table:
    every = evaluation.comparisons
    shown = every if len(every) <= _MOST_ROWS else [one for one in every if one.outcome != "within"]
    title = "Found less true, in the target's axes"
    if len(shown) < len(every):
        title += f" ({len(every) - len(shown)} LiDARs within are not listed)"
    table = plain_table(title, ("run", "LiDAR", "outcome", *_ERROR_COLUMNS, "off by\nsigma"), numbers_from=3)
    labels = _short_names(evaluation.runs)
    before: Comparison | None = None
    for one in shown:
        first = before is None or before.run != one.run
        if first and before is not None:
            table.add_section()
        label = labels[one.run] if first else ""
        sigma = "-" if one.error_sigma is None else f"{one.error_sigma:.1f}"
        table.add_row(label, one.placement.lidar, _WORDS[one.outcome], *_errors(one.error), sigma)
        before = one
    return table


def _short_names(runs: tuple[str, ...]) -> dict[str, str]:
    """Each run without the folder that all are in."""
    try:
        shared = commonpath([Path(run).parent for run in runs])
    except ValueError:
        return {run: run for run in runs}
    return {run: str(Path(run).relative_to(shared)) for run in runs}


def _statistics_table(evaluation: Evaluation) -> Table:
    table = plain_table("Errors of all placed LiDARs", ("LiDAR", "", *_ERROR_COLUMNS), numbers_from=2)
    by_lidar = evaluation.by_lidar
    if len(by_lidar) > 1 and len(evaluation.compared_runs) > 1:
        for lidar, summary in by_lidar.items():
            table.add_row(lidar, "RMSE", *_errors(summary.rmse))
        table.add_section()
    overall = evaluation.overall
    table.add_row("all", "RMSE", *_errors(overall.rmse))
    table.add_row("", "median", *_errors(overall.median))
    table.add_row("", "largest", *_errors(overall.largest))
    return table


def _outcome_table(evaluation: Evaluation) -> Table:
    limits = evaluation.tolerances
    within = f"within\n{1e3 * limits.within_m:g} mm, {degrees(limits.within_rad):g} deg"
    wrong = f"false accept\n> {1e3 * limits.wrong_m:g} mm, {degrees(limits.wrong_rad):g} deg"
    wrong += f" or {limits.wrong_sigma:g} sigma"
    columns = ("LiDAR", "compared", within, "between", wrong, "false refuse\nnot placed")
    table = plain_table("Outcomes", columns)
    by_lidar = evaluation.by_lidar
    if len(by_lidar) > 1:
        for lidar, summary in by_lidar.items():
            table.add_row(lidar, *_counts(summary))
        table.add_section()
    table.add_row("all", *_counts(evaluation.overall))
    return table


def _counts(summary: Summary) -> tuple[str, ...]:
    counts = (summary.within, summary.between, summary.false_accept, summary.false_refuse)
    return str(summary.lidars), *(f"{count} ({count / summary.lidars:.1%})" for count in counts)


def _errors(error: PoseError | None) -> tuple[str, ...]:
    if error is None:
        return ("-",) * len(_ERROR_COLUMNS)
    millimetres = (*error.translation_m, error.distance_m)
    angles = (*error.rotation_rad, error.angle_rad)
    return *(f"{1e3 * value:z.1f}" for value in millimetres), *(f"{degrees(value):z.3f}" for value in angles)
