# SPDX-License-Identifier: Apache-2.0
"""`multilica evaluate` and `multilica datasets`: runs against ground truth, as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from os.path import commonpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from multilica.errors import UsageError
from multilica_cli.options import Json, Quiet, Settings, WithinDeg, WithinM, argument, option, output, topic_names
from multilica_cli.terminal import ERROR_COLUMNS, FoldingTable, number_cells, stdout_console

if TYPE_CHECKING:
    from multilica.datasets import DatasetDocument
    from multilica.runs.evaluation import Evaluation, LeftOut, Summary
    from multilica.runs.paper_table import PaperSummary, PaperTable

_FIGURES = ("x_m", "y_m", "z_m", "distance_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")
_WORDS = {
    "false_accept": "FALSE ACCEPT",
    "false_refuse": "FALSE REFUSE",
    "uncertain_within": "uncertain, within",
    "uncertain_beyond": "UNCERTAIN, BEYOND",
}
_MOST_ROWS = 40
_AXIS_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "angle\ndeg")
_AXES = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")
_SUMMARIES: Mapping[str, Callable[[PaperTable], tuple[Sequence[PaperSummary], PaperSummary]]] = {
    "RMSE over all scenes, to the target": lambda table: (table.by_lidar, table.to_target),
    "RMSE over all scenes, between LiDARs": lambda table: (table.by_pair, table.between),
}
"""Title -> the rows of the summary and that over all of them."""


def evaluate(
    runs: Annotated[list[Path], argument("RUN", "Run directory or its result.json; one or more.")],
    *,
    truths: Annotated[
        list[Path],
        option(
            "--truth FILE",
            "Ground truth as `simulate` writes it, or in any format of export: one file for all runs, or "
            "repeated, one per run in order.",
        ),
    ],
    within_m: WithinM = 0.02,
    within_deg: WithinDeg = 0.1,
    wrong_m: Annotated[float, option("--wrong-m M", "Position error above which it is a false accept.")] = 0.05,
    wrong_deg: Annotated[float, option("--wrong-deg DEG", "Rotation error above which it is a false accept.")] = 0.5,
    wrong_sigma: Annotated[float, option("--wrong-sigma N", "Sigmas above which an error is a false accept.")] = 4.0,
    out: Annotated[
        Path | None, output("--out FILE", "Also write a .parquet or .csv table with a row per LiDAR.")
    ] = None,
    table: Annotated[
        Literal["paper"] | None,
        option("--table paper", "Print the paper's table instead: RMSE per axis, also between the LiDARs."),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare runs with ground truth: RMSE per axis, success rate, false accepts and false refusals."""
    from multilica import read_extrinsics
    from multilica import runs as saved
    from multilica.runs.evaluation import require_table_name, write_table
    from multilica.runs.paper_table import paper_table

    if out is not None:
        require_table_name(out)
    _refuse_repeated(runs)
    tolerances = saved.Tolerances(within_m, within_deg, wrong_m, wrong_deg, wrong_sigma)
    known = [saved.Truth(str(path), read_extrinsics(path)) for path in truths]
    read = [saved.read_run(path) for path in runs]
    evaluation = saved.evaluate(read, known, tolerances)
    of_paper = paper_table(read, known, tolerances) if table else None
    if out is not None:
        write_table(evaluation, out)
    if as_json:
        typer.echo((of_paper or evaluation).model_dump_json(indent=2))
        return
    console = stdout_console(quiet=quiet)
    if of_paper:
        print_paper_table(of_paper, console)
    else:
        print_evaluation(evaluation, console)
    if out is not None:
        console.print(f"wrote {out}")


def _refuse_repeated(runs: Sequence[Path]) -> None:
    """Refuse a run that is given twice, by whatever path."""
    given: set[Path] = set()
    for path in runs:
        whole = path.resolve()
        directory = whole.parent if whole.name == "result.json" else whole
        if directory in given:
            raise UsageError(f"Run {path} is given more than once; give each run once, or it counts twice.")
        given.add(directory)


def datasets(
    name: Annotated[Literal["helipr", "edgar", "opencalib"], typer.Argument(metavar="NAME", help="The data set.")],
    path: Annotated[
        Path,
        argument(
            "PATH",
            "helipr: folder of a sequence. edgar: folder with a ROS 2 bag or a folder of point files per scene. "
            "opencalib: lidar2lidar/auto_calib/data, or one folder of it.",
        ),
    ],
    *,
    out: Annotated[Path | None, output("--out DIR", "Directory for scenes and runs.", "recordings/runs/<NAME>")] = None,
    presets: Annotated[list[str] | None, option("--preset NAME", "Preset to run. Repeatable.", "all")] = None,
    scenes: Annotated[int, option("--scenes N", "Largest number of scenes.")] = 10,
    frames: Annotated[int, option("--frames N", "Frames per LiDAR and scene.")] = 5,
    target: Annotated[str | None, option("--target NAME", "Target LiDAR.", "from the data set")] = None,
    topics: Annotated[
        list[str] | None, option("--topic NAME=/topic", "edgar: the topic of a LiDAR of the truth. Repeatable.")
    ] = None,
    truth: Annotated[
        Path | None, option("--truth FILE", "True poses, as TOML or as the authors' config.yaml.", "from the data set")
    ] = None,
    settings: Settings = None,
    within_m: WithinM = 0.02,
    within_deg: WithinDeg = 0.1,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run the presets on standstills of a data set of the paper, and print the paper's tables next to its figures."""
    from multilica.config import PRESETS
    from multilica.datasets import READERS, SceneRequest, run_presets
    from multilica.runs import Tolerances
    from multilica_cli.progress import show_progress

    limits = Tolerances(within_m, within_deg, max(0.05, within_m), max(0.5, within_deg))
    request = SceneRequest(scenes, frames, topic_names(topics or ()) or {}, truth)
    with show_progress(quiet=quiet) as observe:
        found = run_presets(
            name,
            READERS[name](path, request),
            presets or tuple(PRESETS),
            out or Path("recordings") / "runs" / name,
            limits,
            target=target or "",
            settings=settings or (),
            observe=observe,
        )
    if as_json:
        typer.echo(found.model_dump_json(indent=2))
    else:
        print_dataset(found, stdout_console(quiet=quiet))


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Print errors per LiDAR, statistics, counts, and what was left out."""
    for table in (_detail_table(evaluation), _statistics_table(evaluation), _outcome_table(evaluation)):
        console.print(table)
    runs = evaluation.runs
    console.print(f"runs with every compared LiDAR within tolerance: {runs.faultless} of {runs.compared}")
    targets = sorted({one.target for one in evaluation.lidars})
    if len(targets) > 1:
        console.print(f"note: the axes are those of each run's own target: {', '.join(targets)}")
    print_left_out(evaluation.left_out, console)


def print_left_out(left_out: Sequence[LeftOut], console: Console) -> None:
    """Print what no count includes, with the reason."""
    for each in left_out:
        what = each.run if each.lidar is None else f"{each.run}, LiDAR {each.lidar}"
        console.print(f"left out: {what}: {each.reason}")


def _figure_cells(figures: object, names: Sequence[str] = _FIGURES) -> tuple[str, ...]:
    """Format the figures of these names: lengths in mm, angles in degrees."""
    scales = ((1e3, 1) if name.endswith("_m") else (1.0, 3) for name in names)
    return tuple(number_cells((getattr(figures, name),), *scale)[0] for name, scale in zip(names, scales, strict=True))


def _detail_table(evaluation: Evaluation) -> FoldingTable:
    every = evaluation.lidars
    shown = every if len(every) <= _MOST_ROWS else [one for one in every if one.outcome != "within"]
    title = "Error (found - true) in the target's axes"
    if len(shown) < len(every):
        title += f"; {len(every) - len(shown)} LiDARs within tolerance are not listed"
    table = FoldingTable(title, ("run", "LiDAR", "outcome", *ERROR_COLUMNS, "total\nsigma"), numbers_from=3, keys=2)
    labels, errors = short_names(evaluation.runs.given), [f"error_{name}" for name in _FIGURES]
    for run, comparisons in groupby(shown, key=lambda one: one.run):
        label = labels[run]
        for one in comparisons:
            sigma = "-" if one.error_sigma is None else f"{one.error_sigma:.1f}"
            table.add_row(label, one.lidar, _WORDS.get(one.outcome, one.outcome), *_figure_cells(one, errors), sigma)
            label = ""
        table.add_section()
    return table


def short_names(runs: tuple[str, ...]) -> dict[str, str]:
    """Return each run without the folder that is common to all."""
    try:
        shared = commonpath([Path(run).parent for run in runs])
    except ValueError:
        return {run: run for run in runs}
    return {run: str(Path(run).relative_to(shared)) for run in runs}


def _statistics_table(evaluation: Evaluation) -> FoldingTable:
    table = FoldingTable("Errors of all placed LiDARs", ("LiDAR", "", *ERROR_COLUMNS), numbers_from=2, keys=2)
    if evaluation.runs.compared > 1:
        _add_per_lidar(table, evaluation, lambda summary: ("RMSE", *_figure_cells(summary.rmse)))
    overall = evaluation.overall
    table.add_row("all", "RMSE", *_figure_cells(overall.rmse))
    table.add_row("", "median", *_figure_cells(overall.median))
    table.add_row("", "largest", *_figure_cells(overall.largest))
    return table


def _outcome_table(evaluation: Evaluation) -> FoldingTable:
    from multilica.runs.evaluation import UNCERTAIN_SIGMA

    limits = evaluation.tolerances
    within = f"within\n{1e3 * limits.within_m:g} mm, {limits.within_deg:g} deg"
    wrong = f"false accept\n> {1e3 * limits.wrong_m:g} mm, {limits.wrong_deg:g} deg"
    wrong += f" or {limits.wrong_sigma:g} sigma"
    uncertain = tuple(f"uncertain\n{sign} {UNCERTAIN_SIGMA:g} sigma" for sign in ("<=", ">"))
    columns = ("LiDAR", "compared", within, "between", wrong, "false refuse\nnot placed", *uncertain)
    table = FoldingTable("Outcomes", columns)
    _add_per_lidar(table, evaluation, _counts)
    table.add_row("all", *_counts(evaluation.overall))
    return table


def _add_per_lidar(table: FoldingTable, evaluation: Evaluation, cells: Callable[[Summary], tuple[str, ...]]) -> None:
    """Add a row per LiDAR if there are several."""
    if len(evaluation.by_lidar) > 1:
        for lidar, summary in evaluation.by_lidar.items():
            table.add_row(lidar, *cells(summary))
        table.add_section()


def _counts(summary: Summary) -> tuple[str, ...]:
    from multilica.runs.evaluation import OUTCOMES

    counts = [getattr(summary, outcome) for outcome in OUTCOMES]
    return str(summary.lidars), *(f"{count} ({count / summary.lidars:.1%})" for count in counts)


def print_paper_table(table: PaperTable, console: Console) -> None:
    """Print the errors per scene, their RMSE over scenes and LiDARs, and those between LiDARs."""
    console.print(_scene_table(table))
    for (title, rows_of), key in zip(_SUMMARIES.items(), ("LiDAR", "LiDARs"), strict=True):
        rows, overall = rows_of(table)
        printed = _summary_table(title, (key,), table)
        for summary in rows:
            printed.add_row(summary.name, *_summary_cells(summary))
        if len(rows) > 1:
            printed.add_section()
            printed.add_row(overall.name, *_summary_cells(overall))
        console.print(printed)
    print_left_out(table.left_out, console)


def print_dataset(found: DatasetDocument, console: Console) -> None:
    """Print the paper's tables of each preset with what is published, then times and what was left out."""
    known = found.published
    tables = {name: each.table for name, each in found.presets.items() if each.table is not None}
    first = next(iter(tables.values()), None)
    if known.table is not None:
        tables[known.label] = known.table
    scenes = f"{len(found.scenes)} scene{'s' * (len(found.scenes) != 1)}"
    console.print(f"{found.dataset}: {scenes}: {', '.join(found.scenes)}")
    if tables:
        _print_presets(tables, console)
    for name, each in found.presets.items():
        if each.median_stages_s is not None:
            console.print(f"{name}: {each.median_stages_s:.1f} s per scene (median, stages only, one process)")
    for statement in known.statements:
        console.print(f"published: {statement}")
    for one in found.refused:
        console.print(f"refused: {one.scene}, preset {one.preset}: {one.reason}")
    if found.without_truth:
        console.print(f"without truth, in no table: {', '.join(found.without_truth)}")
    if first is not None:
        print_left_out(first.left_out, console)


def _print_presets(tables: Mapping[str, PaperTable], console: Console) -> None:
    for title, rows_of in _SUMMARIES.items():
        printed = _summary_table(title, ("preset", "LiDAR"), next(iter(tables.values())))
        for label, table in tables.items():
            rows, overall = rows_of(table)
            for index, summary in enumerate((*rows, overall)):
                printed.add_row("" if index else label, summary.name, *_summary_cells(summary))
            printed.add_section()
        console.print(printed)


def _summary_table(title: str, keys: tuple[str, ...], limits: PaperTable) -> FoldingTable:
    """Create a table whose rows are keys, then `_summary_cells`."""
    success = f"success\n{1e3 * limits.within_m:g} mm, {limits.within_deg:g} deg"
    return FoldingTable(
        title, (*keys, "poses", "placed", success, *_AXIS_COLUMNS), numbers_from=len(keys), keys=len(keys)
    )


def _summary_cells(summary: PaperSummary) -> tuple[str, ...]:
    """Format the figures of a row of `_summary_table`."""
    counts = (f"{summary.placed} ({summary.placed_rate:.0%})", f"{summary.successes} ({summary.success_rate:.0%})")
    return str(summary.poses), *counts, *_figure_cells(summary.rmse, _AXES)


def _scene_table(table: PaperTable) -> FoldingTable:
    every = table.rows
    shown = every if len(every) <= _MOST_ROWS else tuple(one for one in every if not one.success)
    title = "Error (found - true) per scene and LiDAR"
    if len(shown) < len(every):
        title += f"; {len(every) - len(shown)} successes are not listed"
    printed = FoldingTable(title, ("run", "LiDAR", "target", "outcome", *_AXIS_COLUMNS), numbers_from=4, keys=2)
    labels = short_names(tuple({one.run for one in every} | {one.run for one in table.left_out}))
    for one in shown:
        outcome = "NOT PLACED" if one.error is None else "success" if one.success else "FAILURE"
        printed.add_row(labels[one.run], one.source, one.target, outcome, *_figure_cells(one, _AXES))
    return printed
