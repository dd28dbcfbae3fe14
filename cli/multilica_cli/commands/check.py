# SPDX-License-Identifier: Apache-2.0
"""`multilica check`, `verify` and `accept`: extrinsics against a reference, as a gate of a pipeline."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from multilica.errors import UsageError
from multilica_cli import options
from multilica_cli.configuration import ingest_options, resolve_config
from multilica_cli.exit_codes import ExitCode
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.checks import RigCheck, RigTolerances

_MaxTranslation = Annotated[
    float, typer.Option("--max-translation", metavar="M", min=1e-6, help="Largest distance that is no drift.")
]
_MaxRotation = Annotated[
    float, typer.Option("--max-rotation", metavar="DEG", min=1e-6, help="Largest rotation that is no drift.")
]
_TolerancesFile = Annotated[
    Path | None,
    typer.Option(
        "--tolerances", metavar="FILE", help=r"TOML with \[default] and \[lidars.NAME] that differ from these."
    ),
]
_Junit = Annotated[
    Path | None, typer.Option("--junit", metavar="FILE", help="Also write a JUnit report.", callback=options.local_path)
]
_Summary = Annotated[
    Path | None,
    typer.Option(
        "--summary",
        metavar="FILE",
        help="Also write a Markdown summary, with a picture FILE.png beside it.",
        callback=options.local_path,
    ),
]
_CodeQuality = Annotated[
    Path | None,
    typer.Option(
        "--code-quality",
        metavar="FILE",
        help="Also write a code quality report for GitLab.",
        callback=options.local_path,
    ),
]


def check(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN|SOURCE",
            help="Run directories or their files, or recordings, which are calibrated first.",
            show_default=False,
        ),
    ],
    *,
    against: Annotated[
        Path,
        typer.Option(
            metavar="REFERENCE", help="A calibration.toml, a run, or another file of poses.", show_default=False
        ),
    ],
    max_translation_m: _MaxTranslation = 0.03,
    max_rotation_deg: _MaxRotation = 0.3,
    tolerances: _TolerancesFile = None,
    junit: _Junit = None,
    summary: _Summary = None,
    code_quality: _CodeQuality = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory of the calibration.",
            show_default="recordings/runs/<source>, or <source>-2, ... if that is taken",
            callback=options.local_path,
        ),
    ] = None,
    topics: options.Topics = None,
    frames: options.Frames = None,
    config_file: options.ConfigFile = None,
    settings: options.Settings = None,
    workers: options.Workers = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Compare the poses of a run with a reference, LiDAR by LiDAR, in units of tolerance and sigma.

    Ends with 0 if all are within their tolerance, 5 if one is outside, 4 if one cannot be decided.
    """
    from multilica.checks import check_rig, decide_unplaced, read_reference
    from multilica.runs.run_documents import is_run, read_run_document, saved_run

    limits = _tolerances(tolerances, max_translation_m, max_rotation_deg)
    _require_reference(against)
    runs = [is_run(Path(source)) for source in sources]
    if any(runs) and not all(runs):
        raise UsageError(
            f"{sources[runs.index(True)]} is a run and {sources[runs.index(False)]} a recording; give only runs, or "
            "only recordings."
        )
    directories = [Path(source) for source in sources]
    if not all(runs):
        from multilica.run import run_calibration
        from multilica_cli.progress import show_progress

        given = {**ingest_options(topics, frames, None, None, None, strict=False), "runtime.workers": workers}
        config = resolve_config(None, config_file, given, settings or ())
        with show_progress(quiet=quiet or as_json) as observe:
            run = run_calibration(sources, out, config, observe=observe)
        directories = [run.directory, *(path for path in run.written if path.is_dir())]
    checks = []
    for path in directories:
        read = read_run_document(path)
        frame_ids = {name: entry.frame_id for name, entry in read.document.input.lidars.items()}
        known = read_reference(against, frame_ids)
        checks.append(check_rig(saved_run(read, str(path)), known, limits))
        if not all(runs) and len(directories) == 1:
            from multilica.ingest import read_snapshot

            checks = [decide_unplaced(checks[0], read_snapshot(sources, config=config.ingest), known, limits, config)]
    return _finish(checks, against, junit, summary, code_quality, quiet=quiet, as_json=as_json)


def verify(
    sources: options.Sources,
    *,
    calibration: Annotated[
        Path,
        typer.Option(metavar="FILE", help="A calibration.toml, a run, or another file of poses.", show_default=False),
    ],
    max_translation_m: _MaxTranslation = 0.03,
    max_rotation_deg: _MaxRotation = 0.3,
    tolerances: _TolerancesFile = None,
    junit: _Junit = None,
    summary: _Summary = None,
    code_quality: _CodeQuality = None,
    topics: options.Topics = None,
    frames: options.Frames = None,
    config_file: options.ConfigFile = None,
    settings: options.Settings = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Tell whether extrinsics are still right on a recording, without a search, and which LiDAR has moved.

    Ends with 0 if all are within their tolerance, 5 if one is outside, 4 if one cannot be decided.
    """
    from multilica.checks import read_reference, verify_snapshot
    from multilica.ingest import frames_recorded, read_snapshot
    from multilica.ingest.locate import locate

    limits = _tolerances(tolerances, max_translation_m, max_rotation_deg)
    _require_reference(calibration)
    files = [locate(source) for source in sources]
    given = ingest_options(topics, frames, None, None, None, strict=False)
    config = resolve_config(None, config_file, given, settings or (), frames_recorded(files))
    snapshot = read_snapshot(files, config=config.ingest)
    known = read_reference(calibration, {lidar.name: lidar.frame_id for lidar in snapshot.lidars})
    found = verify_snapshot(snapshot, known, limits, config)
    for note in () if quiet or as_json else snapshot.notes:
        stdout_console().print(f"note: {note}")
    return _finish([found], calibration, junit, summary, code_quality, quiet=quiet, as_json=as_json)


def accept(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run directory that was reviewed.", show_default=False)],
    *,
    into: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="Reference that pipelines check against, kept in git.",
            show_default=False,
            callback=options.local_path,
        ),
    ],
    max_translation_m: _MaxTranslation = 0.03,
    max_rotation_deg: _MaxRotation = 0.3,
    quiet: options.Quiet = False,
) -> None:
    """Write the extrinsics of a reviewed run, with their provenance, into the file that pipelines check against.

    Shows the difference to what the file had. Refuses a run that does not place every LiDAR, or is in another frame.
    """
    from multilica.checks import accept_run
    from multilica_cli.tables.check import print_check

    console = stdout_console(quiet=quiet)
    before = accept_run(run, into, _tolerances(None, max_translation_m, max_rotation_deg))
    print_check([] if before is None else [before], [into], console)


def _require_reference(path: Path) -> None:
    """Refuse a reference that is not there before anything takes time."""
    from multilica.errors import SourceNotFoundError

    if not path.exists():
        raise SourceNotFoundError(f"No reference at {path}; give a calibration.toml, a run, or another file of poses.")


def _tolerances(path: Path | None, translation_m: float, rotation_deg: float) -> RigTolerances:
    from multilica.checks import RigTolerances, Tolerance, read_tolerances

    default = Tolerance(translation_m=translation_m, rotation_deg=rotation_deg)
    return RigTolerances(default=default) if path is None else read_tolerances(path, default)


def _finish(
    checks: Sequence[RigCheck],
    reference: Path,
    junit: Path | None,
    summary: Path | None,
    code_quality: Path | None,
    *,
    quiet: bool,
    as_json: bool,
) -> int:
    """Write the reports, print the outcome, and return the exit code."""
    from multilica.checks import check_document, joint_verdict
    from multilica.checks.ci_reports import github_annotations, write_reports
    from multilica_cli.tables.check import print_check

    written = write_reports(
        checks,
        str(reference),
        datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        junit=junit,
        summary=summary,
        code_quality=code_quality,
        step_summary=os.environ.get("GITHUB_STEP_SUMMARY") or None,
    )
    if as_json:
        typer.echo(check_document(checks, str(reference)).model_dump_json(indent=2))
    else:
        print_check(checks, written, stdout_console(quiet=quiet))
        if os.environ.get("GITHUB_ACTIONS") == "true":
            for line in github_annotations(checks):
                typer.echo(line)
    codes = {"within": ExitCode.DONE, "outside": ExitCode.DIFFERENT, "undecided": ExitCode.NOT_PLACED}
    return codes[joint_verdict([each.verdict for each in checks])]
