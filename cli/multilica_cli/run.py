# SPDX-License-Identifier: Apache-2.0
"""One calibration from sources to files."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from multilica.errors import UnfitSnapshotError
from multilica_cli.failures import ExitCode
from multilica_cli.interruption import Interrupted
from multilica_cli.terminal import stderr_console

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.config import CalibrationConfig
    from multilica.events import Event, Observer
    from multilica.extrinsics import Extrinsics
    from multilica.ingest.source import PathLike
    from multilica.results import CalibrationResult
    from multilica.sinks.run_directory import Run
    from multilica.snapshot import Snapshot

__all__ = [
    "FinishedRun",
    "both",
    "calibrate_sources",
    "default_out_dir",
    "exit_code_of",
    "read",
    "read_known",
    "told_where",
]


@dataclass(frozen=True, slots=True, eq=False)
class FinishedRun:
    """A result with the files that hold it.

    Args:
        written: paths, the extrinsics first.
    """

    result: CalibrationResult
    out_dir: Path
    written: tuple[Path, ...]


def default_out_dir(sources: Sequence[str | Path], snapshots: int = 1) -> Path:
    """Where a run goes when `--out` is not given; a joint run never where one of its snapshots alone would go."""
    from multilica.ingest.address import stem_of

    more = f"-and-{snapshots - 1}-more" if snapshots > 1 else ""
    return Path("recordings") / "runs" / f"{stem_of(sources[0])}{more}"


def calibrate_sources(
    sources: Sequence[PathLike],
    out_dir: Path,
    config: CalibrationConfig,
    *,
    prior: str | None = None,
    mcap_encoding: str = "foxglove",
    quiet: bool = False,
) -> FinishedRun:
    """Read, calibrate and write, with progress on stderr.

    Args:
        prior: as `--prior` takes it.

    Raises:
        InputError: the sources cannot be read, or hold nothing that can be calibrated.
        UsageError: the configuration names something that does not exist, or `out_dir` cannot be written to.
    """
    from multilica.pipeline import calibrate
    from multilica.sinks.run_directory import open_run
    from multilica_cli.progress import show_progress

    console = stderr_console(quiet=quiet)
    with show_progress(console) as show:
        snapshot = read(sources, config, show, console)
        known = None if prior is None else read_known(prior, snapshot, config, console)
        with open_run(out_dir, config, mcap_encoding) as run, told_where(run):
            result = calibrate(snapshot, config, both(run, show), known)
    return FinishedRun(result, out_dir, run.written)


def both(run: Observer, show: Observer) -> Observer:
    """An observer for files and terminal; the terminal has seen the reading by then."""

    def observe(event: Event) -> None:
        run(event)
        if getattr(event, "stage", None) != "ingest":
            show(event)

    return observe


def read(sources: Sequence[PathLike], config: CalibrationConfig, show: Observer, console: Console) -> Snapshot:
    """The snapshot, after every check that needs no calibration: a refusal must leave earlier results alone."""
    from multilica.events import StageFinished, StageStarted
    from multilica.ingest import read_snapshot, require_calibratable

    show(StageStarted("ingest", 0))
    start_s = time.perf_counter()
    snapshot = read_snapshot(sources, config=config.ingest)
    require_calibratable(snapshot)
    if config.target:
        snapshot[config.target]
    show(StageFinished("ingest", time.perf_counter() - start_s))
    for note in snapshot.notes:
        console.print(f"note: {note}")
    return snapshot


def read_known(prior: str, snapshot: Snapshot, config: CalibrationConfig, console: Console) -> Extrinsics:
    """The prior, refused as early as the snapshot would be."""
    from multilica.ingest import read_prior
    from multilica.stages.prior import require_usable

    known = read_prior(prior, snapshot)
    require_usable(known.extrinsics, snapshot, config)
    for note in known.notes:
        console.print(f"note: {note}")
    return known.extrinsics


def exit_code_of(result: CalibrationResult, config: CalibrationConfig) -> ExitCode:
    """Whether every LiDAR is placed; a run that was to stop before placing any is done as well."""
    from multilica.config import STAGES

    stopped_early = STAGES.index(config.until) < STAGES.index("merge")
    return ExitCode.DONE if stopped_early or result.status == "complete" else ExitCode.NOT_PLACED


@contextmanager
def told_where(run: Run) -> Iterator[None]:
    """Say what is in the run's directory if a signal ends the run or the snapshot is refused."""
    kept = f"The earlier result in {run.directory} is left as it was."
    try:
        yield
    except Interrupted as interrupted:
        interrupted.add_note(kept if run.keeps_earlier else f"The recording up to there is in {run.directory}.")
        raise
    except UnfitSnapshotError as refusal:
        if run.started or run.keeps_earlier:
            refusal.add_note(f"See `multilica explain {run.directory}`." if run.started else kept)
        raise
