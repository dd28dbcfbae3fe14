# SPDX-License-Identifier: Apache-2.0
"""Commands that read saved runs: `explain`, `query`, `diff`, `view`, `report`, `export`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from multilica.errors import UsageError
from multilica.exports import CLOUD_FORMATS, FORMATS
from multilica_cli.commands.calibrate import print_placements
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import Json, Quiet, argument, local_path, option, output, png_name
from multilica_cli.terminal import (
    ERROR_COLUMNS,
    FoldingTable,
    answer_lines,
    number_cells,
    print_json,
    stderr_console,
    stdout_console,
)

if TYPE_CHECKING:
    from multilica.runs.difference import RunDifference

_FORMS: Mapping[str, Literal["csv", "json", "parquet"]] = {".csv": "csv", ".json": "json", ".parquet": "parquet"}
_MOST_CHANGES = 8
_MOST_CHARACTERS = 60

_COMPARED = "A run directory, its result.json, a recording (.rrd), or a file of poses."


def explain(
    run: Annotated[
        Path,
        argument("RUN", "Run directory, its result.json, its result.mcap, or a recording (.rrd), complete or not."),
    ],
    *,
    as_json: Json = False,
) -> None:
    """Explain a run: the placed LiDARs with their accuracy, the others with cause and remedy."""
    from multilica import diagnosis
    from multilica.runs.run_documents import read_run_document

    document = read_run_document(run).document
    explanation = diagnosis.explain(document)
    if as_json:
        print_json(asdict(explanation))
        return
    console = stdout_console()
    print_placements(document, console)
    for line in explanation.lines:
        console.print(line)


def diff(
    run_a: Annotated[Path, argument("RUN_A", _COMPARED)],
    run_b: Annotated[Path, argument("RUN_B", _COMPARED)],
    *,
    within_m: Annotated[
        float, option("--within-m M", "Largest distance that does not count as a move.", min=0.0)
    ] = 1e-4,
    within_deg: Annotated[
        float, option("--within-deg DEG", "Largest rotation that does not count as a move.", min=0.0)
    ] = 1e-3,
    as_json: Json = False,
) -> int:
    """Compare two runs: changed poses, changed statuses, and the first stage that differs.

    With a file of poses, in any format of export, only the poses are compared.

    Exits with 0 if both place the same LiDARs at the same places, with 5 if not.
    """
    from multilica.runs.difference import compare_poses, compare_runs
    from multilica.runs.run_documents import is_run, read_run_document

    limits = {"within_m": within_m, "within_rad": radians(within_deg)}
    files = [path for path in (run_a, run_b) if path.is_file() and not is_run(path)]
    if files:
        from multilica.checks import poses_of

        difference = compare_poses((str(run_a), str(run_b)), poses_of(run_a), poses_of(run_b), **limits)
    else:
        difference = compare_runs(read_run_document(run_a), read_run_document(run_b), **limits)
    if as_json:
        typer.echo(difference.model_dump_json(indent=2))
    else:
        print_difference(difference, stdout_console(), stages=not files)
    return ExitCode.DONE if difference.same else ExitCode.DIFFERENT


def print_difference(difference: RunDifference, console: Console, *, stages: bool = True) -> None:
    """Print which LiDARs moved, which changed status, and at which step the runs first differ."""
    before, after = difference.runs
    console.print(f"A: {before}\nB: {after}")
    if difference.moves:
        console.print(_moves_table(difference))
    for change in difference.statuses.values():
        console.print(f"{change.lidar}: {change.before} in A, {change.after} in B. {change.why}")
    _print_placed_by_neither(difference, console)
    if difference.targets[0] != difference.targets[1]:
        console.print(f"note: the target is {difference.targets[0]} in A and {difference.targets[1]} in B")
    for note in difference.notes:
        console.print(f"note: {note}")
    if stages:
        _print_stage_differences(difference, console)
    console.print(_verdict(difference))


def _print_placed_by_neither(difference: RunDifference, console: Console) -> None:
    """Print LiDARs with the same cause, such as a refused snapshot, in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for each in difference.placed_by_neither.values():
        names.setdefault((each.before, each.after), []).append(each.lidar)
    for (before, after), lidars in names.items():
        why = before if before == after else f"In A: {before} In B: {after}"
        console.print(f"{', '.join(lidars)}: placed neither in A nor in B. {why}")


def _moves_table(difference: RunDifference) -> FoldingTable:
    title = f"Change (B - A) in the axes of {difference.target}"
    table = FoldingTable(title, ("LiDAR", "", *ERROR_COLUMNS, "sigma"), numbers_from=2, keys=2)
    for lidar, move in difference.moves.items():
        sigma = "-" if move.sigmas is None else f"{move.sigmas:.1f}"
        name = f"{lidar} (uncertain)" if move.uncertain else lidar
        lengths = number_cells((*move.translation_m, move.distance_m), 1e3, 1)
        angles = number_cells((*move.rotation_deg, move.angle_deg), 1.0, 3)
        table.add_row(name, "MOVED" if move.moved else "same", *lengths, *angles, sigma)
    return table


def _print_stage_differences(difference: RunDifference, console: Console) -> None:
    if not difference.differences:
        console.print("The runs do not differ at any step.")
        return
    (first, changes), *later = difference.differences.items()
    console.print(f"The runs first differ at: {first}")
    for change in changes[:_MOST_CHANGES]:
        texts = ("none" if value is None else str(value) for value in (change.before, change.after))
        cut = (text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..." for text in texts)
        console.print(f"  {change.what}: {' -> '.join(cut)}")
    if len(changes) > _MOST_CHANGES:
        console.print(f"  and {len(changes) - _MOST_CHANGES} more, see --json")
    if later:
        console.print(f"after it: {', '.join(step for step, _ in later)}")


def _verdict(difference: RunDifference) -> str:
    moved = [lidar for lidar, move in difference.moves.items() if move.moved]
    if difference.same:
        if difference.target in difference.placed_by_neither and not difference.statuses:
            return "Neither run places any LiDAR."
        missing = ", ".join(difference.placed_by_neither)
        return f"Both runs place the same LiDARs at the same places{f'; neither places {missing}' if missing else ''}."
    told = [f"{len(moved)} of {len(difference.moves)} LiDARs moved"] if moved else []
    told += [f"{len(difference.statuses)} changed status"] if difference.statuses else []
    return f"The runs differ: {', '.join(told)}."


def query(
    run: Annotated[Path, argument("RUN", "Run directory, or a recording (.rrd), complete or not.")],
    table: Annotated[
        Literal["pairs", "matches", "surfaces", "merge", "timings"],
        typer.Argument(
            metavar="TABLE",
            help="pairs: figures and pose of each pair. matches: descriptor matches in the LiDARs' own frames. "
            "surfaces: matches of the clouds at the final pose. merge: candidates of each merge step. "
            "timings: seconds of each stage.",
        ),
    ],
    *,
    form: Annotated[
        Literal["csv", "json", "parquet"] | None,
        option(
            "--format csv|json|parquet",
            "Form of the rows; json: an object per line.",
            "that of the file's name, else csv",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write to a file instead of stdout; parquet needs it.", callback=local_path),
    ] = None,
) -> None:
    """Print a table of a run's recording: pairs, matches, merge decisions or timings."""
    named = None if out is None else _FORMS.get(out.suffix)
    if form is not None and named not in (None, form):
        raise UsageError(f"--format {form} and the name {out} contradict each other; leave one of them out.")
    form = form or named or "csv"
    if form == "parquet" and out is None:
        raise UsageError("--format parquet needs a file; add --out FILE.")
    from pyarrow.parquet import write_table

    from multilica.runs.run_report import first_part_of, recording_of_run
    from multilica.sinks.files.atomic import atomic_file
    from multilica.sinks.rerun.reading import read_recorded_table

    found = read_recorded_table(recording_of_run(run), table)
    if found.num_rows == 0 and (part := first_part_of(run)) is not None:
        told = f"{run} joins snapshots, each with its own {table}; see `multilica query {part} {table}`"
        stderr_console().print(f"multilica: {told}.")
    rows = zip(*(column.to_pylist() for column in found.columns), strict=True)
    lines = () if form == "parquet" else answer_lines(found.column_names, rows, form)
    if out is None:
        for line in lines:
            typer.echo(line, nl=False)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(out) as file:
        if form == "parquet":
            write_table(found, file)
        file.writelines(line.encode() for line in lines)


def view(
    run: Annotated[Path, argument("RUN", "A run directory or a recording (.rrd), also one that was cut off.")],
    *,
    png: Annotated[
        Path | None,
        option("--png FILE", "Draw a picture instead of opening a window; needs no screen.", callback=png_name),
    ] = None,
    width_px: Annotated[int, option("--width PX", "Width of the picture.")] = 1600,
    height_px: Annotated[int, option("--height PX", "Height of the picture.")] = 900,
    quiet: Quiet = False,
) -> None:
    """Open the recording of a run in Rerun's viewer, or draw it into a file."""
    from multilica.runs.run_report import picture_of_run, recording_of_run
    from multilica.sinks.files.atomic import atomic_file
    from multilica.sinks.rerun.viewer import show_recording

    if png is None:
        show_recording(recording_of_run(run))
        return
    picture = picture_of_run(run, (width_px, height_px))
    png.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(png) as file:
        file.write(picture)
    stdout_console(quiet=quiet).print(f"wrote {png}")


def report(
    run: Annotated[Path, argument("RUN", "Run directory or recording (.rrd), complete or not.")],
    *,
    out: Annotated[Path | None, output("--out FILE", "File to write.", "RUN/report.html")] = None,
    quiet: Quiet = False,
) -> None:
    """Create report.html for a run that was killed before it wrote one."""
    from multilica.runs.run_report import contents_of_run
    from multilica.sinks.files.atomic import write_text_atomically
    from multilica.sinks.files.result_files import REPORT_HTML
    from multilica.sinks.report.page import report_html

    file = out or (run if run.is_dir() else run.parent) / REPORT_HTML
    if out is None and file.exists():
        raise UsageError(f"{file} already exists and may show more than a new one; give --out FILE.")
    text = report_html(contents_of_run(run))
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text_atomically(file, text)
    stdout_console(quiet=quiet).print(f"wrote {file}")


def _listed(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}"


def export(
    run: Annotated[Path, argument("RUN", "Run directory, its result.json or result.mcap, or a recording.")],
    *,
    to: Annotated[str, option("--to FORMAT", f"{_listed(FORMATS)}; for the stitched cloud {_listed(CLOUD_FORMATS)}.")],
    out: Annotated[
        str,
        option(
            "--out FILE", "File to write; in an existing URDF or Autoware file, only the poses of the LiDARs change."
        ),
    ],
    base: Annotated[
        str | None,
        option(
            "--base FRAME",
            "Frame of the poses: a LiDAR, a frame of --rig, or, without --rig, the run's base frame or another "
            "name of the target.",
            "the frame of calibrate --rig, else the target",
        ),
    ] = None,
    rig: Annotated[
        Path | None, option("--rig FILE", "Known pose of the target in FRAME: TOML, URDF or any format of --to.")
    ] = None,
    frames: Annotated[
        Literal["names", "ids"],
        option("--frames names|ids", "Call frames by the LiDARs' names, or by the frame ids of the input."),
    ] = "names",
    with_uncertain: Annotated[bool, option("--with-uncertain", "Export uncertain LiDARs too.")] = False,
    quiet: Quiet = False,
) -> int:
    """Write the poses of a run as a file for other programs, or its clouds in one frame.

    Exits with 4 if a LiDAR of the run is not placed.
    """
    from multilica.exports import export_run

    done = export_run(run, out, to, base=base, rig=rig, frames=frames, with_uncertain=with_uncertain)
    stdout_console(quiet=quiet).print(f"wrote {done.path}: {', '.join(done.lidars)} in {done.base}")
    told = stderr_console()
    if done.missing:
        listed = ", ".join(f"{name} ({status.replace('_', ' ')})" for name, status in done.missing.items())
        told.print(f"multilica: Without {listed}.")
    if done.uncertain:
        which = "which is" if len(done.uncertain) == 1 else "which are"
        told.print(f"multilica: With {', '.join(done.uncertain)}, {which} uncertain.")
    if lost := ", ".join(done.without_covariance):
        told.print(f"multilica: Without the covariance of {lost}, as the run has none of {done.base}.")
    return ExitCode.DONE if done.complete else ExitCode.NOT_PLACED
