# SPDX-License-Identifier: Apache-2.0
"""`multilica check`, `verify` and `accept`: extrinsics against a reference, as a gate of a pipeline."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from multilica.errors import UsageError
from multilica_cli import options
from multilica_cli.exit_codes import ExitCode
from multilica_cli.options import argument, option, output
from multilica_cli.terminal import FoldingTable, number_cells, stdout_console

if TYPE_CHECKING:
    from multilica.checks import RigCheck, RigTolerances
    from multilica.config import CalibrationConfig

_COLUMNS = ("verdict", "LiDAR", "off\nmm", "sigma\nmm", "of\nmm", "off\ndeg", "sigma\ndeg", "of\ndeg")
MaxTranslation = Annotated[
    float, option("--max-translation M", "Largest distance that does not count as drift.", min=1e-6)
]
MaxRotation = Annotated[float, option("--max-rotation DEG", "Largest rotation that does not count as drift.", min=1e-6)]
_MOST_M, _MOST_DEG = 100.0, 180.0


@dataclass(frozen=True, slots=True)
class Gate:
    """The group of options for what passes, and for reports to CI services."""

    max_translation_m: MaxTranslation = 0.03
    max_rotation_deg: MaxRotation = 0.3
    tolerances: Annotated[
        Path | None, option("--tolerances FILE", r"TOML with \[default] and \[lidars.NAME], which replace these.")
    ] = None
    junit: Annotated[Path | None, output("--junit FILE", "Also write a JUnit report.")] = None
    summary: Annotated[
        Path | None, output("--summary FILE", "Also write a Markdown summary, with a picture FILE.png beside it.")
    ] = None
    code_quality: Annotated[
        Path | None, output("--code-quality FILE", "Also write a code quality report for GitLab.")
    ] = None

    def limits(self, reference: Path) -> RigTolerances:
        """Return the tolerances; refuse a reference or a report that cannot be used before anything takes time."""
        from multilica.checks import read_tolerances, require_reference
        from multilica.checks.ci_reports import require_reports

        default = tolerances_of(self.max_translation_m, self.max_rotation_deg)
        found = default if self.tolerances is None else read_tolerances(self.tolerances, default.default)
        require_reference(reference)
        require_reports(self.junit, self.summary, self.code_quality)
        return found


@dataclass(frozen=True, slots=True)
class Compared:
    """The group of options for reading a recording that is compared."""

    topics: options.Topics = None
    frames: options.Frames = None
    config_file: options.ConfigFile = None
    settings: options.Settings = None
    max_time_s: options.MaxTime = None

    def resolve(
        self,
        workers: int | None = None,
        recorded_frames: int | None = None,
        timeout_s: float | None = None,
        stops: str | None = None,
    ) -> CalibrationConfig:
        """Build the configuration."""
        given = options.Reading(self.topics, self.frames).values | {
            "runtime.workers": workers,
            "runtime.max_time_s": self.max_time_s,
            "ingest.timeout_s": timeout_s,
            "drive.stops": options.stops_value(stops),
        }
        return options.Parameters(None, self.config_file, self.settings).resolve(given, recorded_frames)


def check(
    sources: Annotated[
        list[str], argument("RUN|SOURCE", "Run directories or their files, or recordings, which are calibrated first.")
    ],
    *,
    against: Annotated[Path, option("--against REFERENCE", "A calibration.toml, a run, or another file of poses.")],
    gate: Gate,
    out: Annotated[Path | None, output("--out DIR", "Directory of the calibration.", options.NEW_RUN_DIRECTORY)] = None,
    recording: Compared,
    stops: options.Stops = None,
    workers: options.Workers = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Compare the poses of a run with a reference, LiDAR by LiDAR, in units of tolerance and sigma.

    Exits with 0 if all are within their tolerance, 5 if one is outside, 4 if one cannot be decided.
    """
    from multilica.runs.run_documents import is_run

    limits = gate.limits(against)
    runs = [is_run(Path(source)) for source in sources]
    if any(runs) and not all(runs):
        raise UsageError(
            f"{sources[runs.index(True)]} is a run and {sources[runs.index(False)]} a recording; give only runs, or "
            "only recordings."
        )
    if all(runs):
        _refuse_of_recordings(recording, {"--stops": stops, "--workers": workers})
        checks = _of_runs([Path(source) for source in sources], against, limits, alone=True)
    else:
        config = recording.resolve(workers, stops=stops)
        checks = _of_recordings(sources, against, limits, config, out, quiet=quiet or as_json)
    return _finish(checks, against, gate, quiet=quiet, as_json=as_json)


def _of_recordings(
    sources: Sequence[str],
    against: Path,
    limits: RigTolerances,
    config: CalibrationConfig,
    out: Path | None,
    *,
    quiet: bool,
) -> list[RigCheck]:
    """Calibrate recordings, and compare the poses of each stop with the reference."""
    from multilica.checks import (
        absent_lidars,
        decide_unplaced,
        poses_of,
        read_reference,
        settle_stops,
        verify_stops,
        with_absent,
    )
    from multilica.ingest import read_drive
    from multilica.ingest.locate import locate
    from multilica.optional_libraries import leave_out_pandas
    from multilica.orchestration.state import deadline_of
    from multilica.run import run_calibration
    from multilica.runs.run_documents import read_run_document
    from multilica_cli.progress import show_progress

    leave_out_pandas()
    files = [locate(source) for source in sources]
    poses_of(against)  # before the calibration, which takes time
    deadline_s = deadline_of(config)
    with show_progress(quiet=quiet) as observe:
        run = run_calibration(files, out, config, observe=observe)
    directories = [run.directory, *(path for path in run.written if path.is_dir())]
    checks = [*settle_stops(_of_runs(directories, against, limits, alone=False))]
    inputs = [read_run_document(path).document.input for path in directories]
    frame_ids = {name: entry.frame_id for each in inputs for name, entry in each.lidars.items()}
    absent = absent_lidars(against, frame_ids)
    if any(check.verdict == "undecided" for check in checks):
        known, present = read_reference(against, frame_ids), limits.without(absent)
        snapshots = read_drive(files, config.drive.stops if len(directories) > 1 else 1, config=config.ingest)
        if len(checks) == 1:
            checks = [decide_unplaced(checks[0], snapshots[0], known, present, config, deadline_s)]
        else:
            checks = [*settle_stops([*checks, *verify_stops(snapshots, known, present, config, deadline_s)])]
    return [with_absent(each, absent, limits, chosen=config.ingest.chooses_topics) for each in checks]


def _of_runs(directories: Sequence[Path], against: Path, limits: RigTolerances, *, alone: bool) -> list[RigCheck]:
    """Compare runs with the reference.

    Args:
        alone: they are no stops of one drive, so that LiDARs are missing that only the reference has.
    """
    from multilica.checks import absent_lidars, check_rig, read_reference, with_absent
    from multilica.runs.run_documents import read_run_document, saved_run

    checks: list[RigCheck] = []
    for path in directories:
        read = read_run_document(path)
        given = read.document.input
        frame_ids = {lidar: entry.frame_id for lidar, entry in given.lidars.items()}
        absent = absent_lidars(against, frame_ids)
        found = check_rig(saved_run(read, str(path)), read_reference(against, frame_ids), limits.without(absent))
        found = found.model_copy(update={"notes": (*found.notes, *given.notes)})
        chosen = read.document.config.ingest.chooses_topics
        checks.append(with_absent(found, absent, limits, chosen=chosen) if alone else found)
    return checks


def _refuse_of_recordings(recording: Compared, given: dict[str, object]) -> None:
    """Refuse options that only recordings have."""
    given |= {
        "--topic": recording.topics,
        "--frames": recording.frames,
        "--config": recording.config_file,
        "--set": recording.settings,
        "--max-time": recording.max_time_s,
    }
    if found := next((name for name, value in given.items() if value), None):
        raise UsageError(f"{found} is for recordings, which are calibrated first; a run has its poses already.")


def verify(
    sources: options.Sources,
    *,
    calibration: Annotated[Path, option("--calibration FILE", "A calibration.toml, a run, or another file of poses.")],
    gate: Gate,
    recording: Compared,
    stops: options.Stops = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> int:
    """Test known extrinsics on a recording, without a search, and name a LiDAR that has moved, by stop.

    Exits with 0 if all are within their tolerance, 5 if one is outside, 4 if one cannot be decided.
    """
    from multilica.checks import absent_lidars, read_reference, verify_stops, with_absent, without_common_view
    from multilica.ingest import frames_recorded, read_drive
    from multilica.ingest.locate import locate
    from multilica.orchestration.state import deadline_of

    limits = gate.limits(calibration)
    files = [locate(source) for source in sources]
    config = recording.resolve(recorded_frames=frames_recorded(files), stops=stops)
    deadline_s = deadline_of(config)
    snapshots = read_drive(files, config.drive.stops, config=config.ingest)
    frame_ids = {lidar.name: lidar.frame_id for snapshot in snapshots for lidar in snapshot.lidars}
    known, absent = read_reference(calibration, frame_ids), absent_lidars(calibration, frame_ids)
    checks = without_common_view(verify_stops(snapshots, known, limits.without(absent), config, deadline_s))
    found = [with_absent(each, absent, limits, chosen=config.ingest.chooses_topics) for each in checks]
    return _finish(found, calibration, gate, quiet=quiet, as_json=as_json)


def accept(
    run: Annotated[Path, argument("RUN", "Run directory that was reviewed.")],
    *,
    into: Annotated[Path, output("--into FILE", "Reference that pipelines check against, kept in git.")],
    max_translation_m: MaxTranslation = 0.03,
    max_rotation_deg: MaxRotation = 0.3,
    quiet: options.Quiet = False,
) -> None:
    """Write the extrinsics of a reviewed run, with their provenance, into the file that pipelines check against.

    Shows the difference to the earlier file. Refuses a run that does not place every LiDAR, or is in another frame.
    """
    from multilica.checks import accept_run

    before = accept_run(run, into, tolerances_of(max_translation_m, max_rotation_deg))
    _print_check([] if before is None else [before], [into], stdout_console(quiet=quiet))


def tolerances_of(translation_m: float, rotation_deg: float) -> RigTolerances:
    """Return the same tolerance for each LiDAR."""
    from multilica.checks import RigTolerances, Tolerance

    if not translation_m <= _MOST_M:
        raise UsageError(f"Found --max-translation {translation_m:g}; expected at most {_MOST_M:g} m.")
    if not rotation_deg <= _MOST_DEG:
        raise UsageError(f"Found --max-rotation {rotation_deg:g}; expected at most {_MOST_DEG:g} degrees.")
    return RigTolerances(default=Tolerance(translation_m=translation_m, rotation_deg=rotation_deg))


def _finish(checks: Sequence[RigCheck], reference: Path, gate: Gate, *, quiet: bool, as_json: bool) -> int:
    """Write the reports, print the outcome, and return the exit code."""
    from multilica.checks import check_document
    from multilica.checks.ci_reports import github_annotations, write_reports

    written = write_reports(
        checks,
        str(reference),
        datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        junit=gate.junit,
        summary=gate.summary,
        code_quality=gate.code_quality,
        step_summary=os.environ.get("GITHUB_STEP_SUMMARY") or None,
    )
    document = check_document(checks, str(reference))
    if as_json:
        typer.echo(document.model_dump_json(indent=2))
    else:
        _print_check(checks, written, stdout_console(quiet=quiet))
        if len(checks) > 1:
            stdout_console(quiet=quiet).print(f"result of all {len(checks)}: {document.sentence}")
        if os.environ.get("GITHUB_ACTIONS") == "true":
            for line in github_annotations(checks):
                typer.echo(line)
    codes = {"within": ExitCode.DONE, "outside": ExitCode.DIFFERENT, "undecided": ExitCode.NOT_PLACED}
    return codes[document.verdict]


def _print_check(checks: Sequence[RigCheck], written: Sequence[Path], console: Console) -> None:
    """Print a table per rig, the reasons of what is not within, and the outcome."""
    from multilica.checks.ci_reports import word_of

    for rig in checks:
        table = FoldingTable(f"compared to {rig.root}: {rig.name}", _COLUMNS, numbers_from=2, keys=2)
        for each in rig.lidars:
            lengths = number_cells((each.distance_m, each.sigma_m), 1000.0, 1)
            angles = number_cells((each.angle_deg, each.sigma_deg), 1.0, 3)
            limits = f"{1000.0 * each.max_translation_m:g}", f"{each.max_rotation_deg:g}"
            table.add_row(word_of(each), each.lidar, *lengths, limits[0], *angles, limits[1])
        console.print(table)
        for each in rig.lidars:
            if each.verdict != "within" or each.elsewhere:
                console.print(f"LiDAR {each.lidar}: {each.reason}")
        for note in rig.notes:
            console.print(f"note: {note}")
    for path in written:
        console.print(f"wrote {path}")
    for rig in checks:
        console.print(f"result: {rig.sentence}" if len(checks) == 1 else f"result of {rig.name}: {rig.sentence}")
