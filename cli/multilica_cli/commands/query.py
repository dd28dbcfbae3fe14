# SPDX-License-Identifier: Apache-2.0
"""Command `query`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from multilica.errors import UsageError
from multilica_cli.options import argument, local_path


def query(
    run: Annotated[Path, argument("RUN", "Run directory, or a recording (.rrd), complete or not.")],
    table: Annotated[
        Literal["pairs", "matches", "surfaces", "merge", "timings"],
        typer.Argument(
            metavar="TABLE",
            help="pairs: figures and pose of each pair. matches: descriptor matches in the LiDARs' own frames. "
            "surfaces: matches of the clouds at the final pose. merge: candidates of each merge step. "
            "timings: seconds of each stage.",
            show_default=False,
        ),
    ],
    *,
    form: Annotated[
        Literal["csv", "json", "parquet"],
        typer.Option("--format", metavar="csv|json|parquet", help="Form of the rows; json: an object per line."),
    ] = "csv",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write to a file instead of stdout; parquet needs it.", callback=local_path),
    ] = None,
) -> None:
    """Print a table of a run's recording: pairs, matches, merge decisions or timings."""
    if form == "parquet" and out is None:
        raise UsageError("--format parquet needs a file; add --out FILE.")
    from multilica.runs.run_report import table_of_run, write_parquet
    from multilica.sinks.files.atomic import write_text_atomically
    from multilica_cli.tables.answer import answer_lines

    found = table_of_run(run, table)
    if out is not None and form == "parquet":
        write_parquet(found, out)
        return
    rows = zip(*(column.to_pylist() for column in found.columns), strict=True)
    lines = answer_lines(found.column_names, rows, "json" if form == "json" else "csv")
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(out, "".join(lines))
        return
    for line in lines:
        typer.echo(line, nl=False)
