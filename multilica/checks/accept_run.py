# SPDX-License-Identifier: Apache-2.0
"""Acceptance of a reviewed run as the reference of later checks."""

from pathlib import Path

from multilica.checks.comparison import RigCheck, check_rig
from multilica.checks.tolerances import RigTolerances
from multilica.documents import MAX_TOML_BYTES, read_limited
from multilica.errors import SourceNotFoundError, UnfitRunError
from multilica.extrinsics import read_extrinsics
from multilica.runs.run_documents import SavedRun, read_run
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.files.result_files import CALIBRATION_TOML


def accept_run(directory: Path, into: Path, tolerances: RigTolerances) -> RigCheck | None:
    """Write the `calibration.toml` of a run, with its provenance, where the accepted extrinsics are kept.

    Args:
        directory: of the run.
        into: replaced whole, and only by a run in the same frame that places every LiDAR it has.

    Returns:
        The run beside what was accepted before; None where there was nothing, or nothing to compare.

    Raises:
        SourceNotFoundError: there is no run.
        UnreadableSourceError: the run or the file is damaged.
        UnfitRunError: the run places too little, or is in another frame than the file.
    """
    run = read_run(directory)
    file = (directory if directory.is_dir() else directory.parent) / CALIBRATION_TOML
    if not file.exists():
        raise SourceNotFoundError(f"{directory} has no {CALIBRATION_TOML}; give the directory that a run left.")
    _require_whole(run, directory)
    new = read_extrinsics(file)
    before = None
    if into.exists():
        old = read_extrinsics(into)
        if missing := sorted(old.members - new.members):
            raise UnfitRunError(
                f"{directory} has no LiDAR {', '.join(missing)}, which {into} has; remove it there first."
            )
        if old.target != new.target:
            raise UnfitRunError(
                f"{directory} is in the frame of {new.target}, {into} in that of {old.target}; "
                f"calibrate with --target {old.target}."
            )
        before = check_rig(run, old, tolerances) if len(old.members) > 1 else None
    write_text_atomically(into, read_limited(file, MAX_TOML_BYTES).decode("utf-8"))
    return before


def _require_whole(run: SavedRun, directory: Path) -> None:
    without = [each.lidar for each in run.placements if each.T_target_source is None or each.uncertain]
    if without:
        raise UnfitRunError(
            f"{directory} does not place {', '.join(without)}; accept a run that places every LiDAR "
            f"(`multilica explain {directory}` says what would help)."
        )
