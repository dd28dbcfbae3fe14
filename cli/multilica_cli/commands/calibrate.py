# SPDX-License-Identifier: Apache-2.0
"""`multilica calibrate` and `multilica demo`: calibration of a recording or of the embedded sample."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from multilica.errors import InputError
from multilica_cli.exit_codes import exit_code
from multilica_cli.options import (
    LIVE_SOURCE,
    NEW_RUN_DIRECTORY,
    RECORDINGS,
    Json,
    MaxTime,
    Parameters,
    Quiet,
    Reading,
    Stops,
    Timeout,
    Workers,
    argument,
    located,
    option,
    output,
    sigma_limits,
    stops_value,
)
from multilica_cli.terminal import (
    POSE_COLUMNS,
    FoldingTable,
    number_cells,
    pose_cells,
    print_json,
    size_cells,
    stdout_console,
)

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.results import Spread
    from multilica.results.document import ResultDocument
    from multilica.run import CalibrationRun

SAMPLE_NAME = "edgar-street"
_STATUS = {"placed": "placed", "uncertain": "UNCERTAIN", "not_placed": "NOT PLACED"}


def calibrate(
    sources: Annotated[
        list[str],
        argument(
            "SOURCE",
            f"{RECORDINGS} Or {LIVE_SOURCE}.",
        ),
    ],
    *,
    target: Annotated[
        str | None,
        option("--target NAME", "LiDAR whose frame is the frame of the result.", "the one with the most overlap"),
    ] = None,
    out: Annotated[Path | None, output("--out DIR", "Directory for the results.", NEW_RUN_DIRECTORY)] = None,
    prior: Annotated[
        str | None,
        option(
            "--prior tf|FILE",
            "Known poses to test in addition: tf (the recording's /tf_static), or a TOML, URDF or other file of poses.",
        ),
    ] = None,
    reading: Reading,
    stops: Stops = None,
    timeout_s: Timeout = None,
    parameters: Parameters,
    max_sigma: Annotated[
        str | None,
        option(
            "--max-sigma MM,DEG",
            "Largest standard deviations of a placed LiDAR; above one of them it is uncertain.",
            "20,0.2",
        ),
    ] = None,
    until: Annotated[str | None, option("--until STAGE", "Stop after this stage.")] = None,
    workers: Workers = None,
    max_time_s: MaxTime = None,
    ground: Annotated[bool, option("--ground", "Also estimate roll, pitch and height above ground.")] = False,
    base: Annotated[
        str | None,
        option(
            "--base FRAME",
            "Name of the base frame on the ground; implies --ground.",
            "the common frame of --rig, else base",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        option(
            "--rig FILE", "x, y and yaw of the target in FRAME: TOML, URDF or any format of export; implies --ground."
        ),
    ] = None,
    record: Annotated[
        Literal["full", "normal", "slim"] | None,
        option("--record full|normal|slim", "Level of detail of recording.rrd.", "normal"),
    ] = None,
    mcap_encoding: Annotated[
        Literal["foxglove", "ros2"], option("--mcap-encoding foxglove|ros2", "Message encoding of result.mcap.")
    ] = "foxglove",
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Calibrate the LiDARs of a recording or a running vehicle and write the results into a directory.

    Several recordings of the same LiDARs are several snapshots of one rig: each is calibrated alone, then all jointly.
    """
    from multilica.orchestration import open_calibration_workers

    known = None
    if rig is not None:
        from multilica import read_extrinsics

        with _refusal_told(as_json=as_json):
            known = read_extrinsics(rig)
        base = base or known.target
    given = {
        "target": target,
        "until": until,
        **reading.values,
        "ingest.timeout_s": timeout_s,
        **sigma_limits(max_sigma),
        "drive.stops": stops_value(stops),
        "ground.enabled": ground or base is not None or None,
        "ground.frame": base,
        "runtime.workers": workers,
        "runtime.max_time_s": max_time_s,
        "record.detail": record,
    }
    resolve = partial(parameters.resolve, given)
    with _refusal_told(as_json=as_json), open_calibration_workers(resolve()) as pool:
        # Imported while the workers start.
        from multilica.ingest import frames_recorded
        from multilica.optional_libraries import leave_out_pandas
        from multilica.run import run_calibration
        from multilica_cli.progress import show_progress, tell_listening

        leave_out_pandas()
        files = located(sources)
        config = resolve(frames_recorded(files))
        tell_listening(files, config.ingest, quiet=quiet)
        with show_progress(quiet=quiet) as observe:
            poses = _prior(prior)
            run = run_calibration(
                files, out, config, prior=poses, rig=known, mcap_encoding=mcap_encoding, observe=observe, workers=pool
            )
    if as_json:
        typer.echo((run.directory / "result.json").read_text(encoding="utf-8"), nl=False)
    else:
        print_run(run, quiet=quiet)
    return exit_code(run)


@contextmanager
def _refusal_told(*, as_json: bool) -> Iterator[None]:
    """Print a refusal as the part of the result document that says so, if the document was asked for."""
    try:
        yield
    except InputError as refusal:
        if as_json:
            print_json({"status": "failed", "refusal": {"code": refusal.code, "text": str(refusal)}})
        raise


def _prior(source: str | None) -> str | Extrinsics | None:
    """Read a prior of a format that is not the library's own to read: it knows tf, TOML and URDF."""
    if source is None or source == "tf" or Path(source).suffix in (".toml", ".urdf", ".xml", ".xacro"):
        return source
    from multilica import read_extrinsics

    return read_extrinsics(source)


def demo(
    *,
    out: Annotated[Path, output("--out DIR", "Directory for the results.")] = Path("recordings/runs/demo"),
    quiet: Quiet = False,
) -> int:
    """Calibrate the embedded sample and compare the result with the ground truth."""
    from multilica.config import preset
    from multilica.exports import read_extrinsics
    from multilica.optional_libraries import leave_out_pandas
    from multilica.run import run_calibration
    from multilica_cli.progress import show_progress

    leave_out_pandas()
    sample = find_sample()
    with show_progress(quiet=quiet) as observe:
        run = run_calibration(sample.recording, out, preset("default"), observe=observe)
    print_run(run, read_extrinsics(sample.truth), quiet=quiet)
    return exit_code(run)


@dataclass(frozen=True, slots=True)
class Sample:
    """A simulated MCAP file with a TOML file of its exact extrinsics."""

    recording: Path
    truth: Path


def find_sample() -> Sample:
    """Find the embedded sample in the installed package or in the checkout; FileNotFoundError if it is in neither."""
    package = Path(__file__).parents[1]
    folders = (package / "samples", package.parents[1] / "recordings" / "samples")
    for folder in folders:
        sample = Sample(folder / f"{SAMPLE_NAME}.mcap", folder / f"{SAMPLE_NAME}.truth.toml")
        if sample.recording.is_file() and sample.truth.is_file():
            return sample
    raise FileNotFoundError(2, "the embedded sample is missing; `make sample` creates it", str(folders[-1]))


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
    columns += ("to prior\nmm", "to prior\ndeg") if prior else ()
    columns += ("spread\nmm", "spread\ndeg", "snap-\nshots") if document.snapshots else ()
    title = f"T_target_source, target {document.target}"
    table = FoldingTable(title, columns, numbers_from=2, spare=("fitness",))
    for name, entry in lidars.items():
        is_target = name == document.target
        status = "target" if is_target else _STATUS[entry.status]
        scores: tuple[str, ...] = ("-",) * 3
        if entry.xyz_m is not None and not is_target:
            fitness = number_cells((entry.fitness,), 1.0, 3)
            scores = (*size_cells(*(entry.largest_sigmas or (None, None))), *fitness)
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


def _spread(spread: Spread | None) -> tuple[str, ...]:
    """Return the standard deviations over the snapshots of the worst axes, and the number of snapshots."""
    if spread is None or spread.xyz_m is None or spread.rotation_deg is None:
        return ("-", "-", "-" if spread is None else str(spread.snapshots))
    return (*size_cells(max(spread.xyz_m), max(spread.rotation_deg)), str(spread.snapshots))
