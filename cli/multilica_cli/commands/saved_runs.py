# SPDX-License-Identifier: Apache-2.0
"""Commands that read saved runs: `explain`, `diff`, `evaluate`, `view`, `report`."""

from dataclasses import asdict
from math import radians
from pathlib import Path
from typing import Annotated, Literal

import typer

from multilica.errors import UsageError
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import Json, Quiet, WithinDeg, WithinM, argument, option, output
from multilica_cli.terminal import print_json, stdout_console

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
    from multilica_cli.tables.result import print_placements

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
    from multilica_cli.tables.errors import print_difference

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
        print_difference(difference, stdout_console())
    return ExitCode.DONE if difference.same else ExitCode.DIFFERENT


def evaluate(
    runs: Annotated[list[Path], argument("RUN", "Run directory or its result.json; one or more.")],
    *,
    truths: Annotated[
        list[Path],
        option(
            "--truth FILE",
            "Ground truth as `simulate` writes it, or in any format of export: one file for all runs, or "
            "repeated, one per run in order.",
            show_default=False,
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
    from multilica_cli.tables.errors import print_evaluation
    from multilica_cli.tables.paper import print_paper_table

    if out is not None:
        require_table_name(out)
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


def view(
    run: Annotated[Path, argument("RUN", "A run directory or a recording (.rrd), also one that was cut off.")],
    *,
    png: Annotated[
        Path | None, output("--png FILE", "Draw a picture instead of opening a window; needs no screen.")
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
    with atomic_file(png) as file:
        file.write(picture)
    stdout_console(quiet=quiet).print(f"wrote {png}")


def report(
    run: Annotated[Path, argument("RUN", "Run directory or recording (.rrd), complete or not.")],
    *,
    out: Annotated[Path | None, output("--out FILE", "File to write.", show_default="RUN/report.html")] = None,
    quiet: Quiet = False,
) -> None:
    """Create report.html for a run that was killed before it wrote one."""
    from multilica.runs.run_report import report_of_run
    from multilica.sinks.files.atomic import write_text_atomically
    from multilica.sinks.files.run_files import REPORT_HTML

    file = out or (run if run.is_dir() else run.parent) / REPORT_HTML
    if out is None and file.exists():
        raise UsageError(f"{file} already exists and may show more than a new one; give --out FILE.")
    write_text_atomically(file, report_of_run(run))
    stdout_console(quiet=quiet).print(f"wrote {file}")
