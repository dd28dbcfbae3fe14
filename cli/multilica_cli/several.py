# SPDX-License-Identifier: Apache-2.0
"""Several snapshots from sources to the files of one joint result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from multilica_cli.run import FinishedRun, both, read, read_known, told_where
from multilica_cli.terminal import stderr_console

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.config import CalibrationConfig
    from multilica.ingest import SnapshotSource
    from multilica.joint import SnapshotRun

__all__ = ["calibrate_snapshots"]


def calibrate_snapshots(
    sources: Sequence[SnapshotSource],
    out_dir: Path,
    config: CalibrationConfig,
    *,
    prior: str | None = None,
    mcap_encoding: str = "foxglove",
    quiet: bool = False,
) -> FinishedRun:
    """Calibrate each snapshot into a directory of its own below `out_dir`, then all of them jointly into that.

    Raises:
        InputError: a source cannot be read, or every snapshot is unfit.
        UsageError: the configuration names what does not exist or cannot be joined, or `out_dir` cannot be written to.
    """
    from multilica.ingest import read_snapshot, require_lidar
    from multilica.joint import join, require_joinable, retell, shown_snapshot
    from multilica.sinks.run_directory import open_run

    require_joinable(config)
    if config.target:
        require_lidar(config.target, sources)
    console = stderr_console(quiet=quiet)
    with open_run(out_dir, config, mcap_encoding) as run, told_where(run):
        run.clear()  # an interrupted run must not leave the joint result of an earlier one beside its own snapshots
        alone = [
            _calibrate_one(source, out_dir / source.name, config, prior, mcap_encoding, console) for source in sources
        ]
        result = join(alone, config)
        shown = next(source for source in sources if source.name == shown_snapshot(result))
        result = retell(read_snapshot(shown.paths, config=config.ingest), result, config, run)
    directories = tuple(path for source in sources if (path := out_dir / source.name).is_dir())
    return FinishedRun(result, out_dir, run.written + directories)


def _calibrate_one(
    source: SnapshotSource,
    out_dir: Path,
    config: CalibrationConfig,
    prior: str | None,
    mcap_encoding: str,
    console: Console,
) -> SnapshotRun:
    """One snapshot by itself; unfit ones become a refusal, for others may do without it."""
    from multilica.errors import UnfitSnapshotError
    from multilica.joint import SnapshotRun
    from multilica.pipeline import calibrate
    from multilica.sinks.run_directory import open_run
    from multilica_cli.progress import show_progress

    console.print(f"snapshot {source.name}")
    path = str(source.paths[0])
    with show_progress(console) as show:
        try:
            snapshot = read(source.paths, config.model_copy(update={"target": ""}), show, console)
            target = config.target if config.target in snapshot.names else ""
            own = config.model_copy(update={"target": target})
            known = None if prior is None else read_known(prior, snapshot, own, console)
            with open_run(out_dir, own, mcap_encoding) as run:
                result = calibrate(snapshot, own, both(run, show), known)
        except UnfitSnapshotError as refusal:
            console.print(f"left out: {refusal}")
            return SnapshotRun(source.name, None, path, refusal=str(refusal))
    return SnapshotRun(source.name, result, path, snapshot.source_sha256)
