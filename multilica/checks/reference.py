# SPDX-License-Identifier: Apache-2.0
"""Reference extrinsics of a check: read from a file, or accepted from a reviewed run."""

from collections.abc import Collection, Mapping
from pathlib import Path

from multilica.checks.comparison import RigCheck, check_rig
from multilica.checks.tolerances import RigTolerances
from multilica.documents import MAX_TOML_BYTES, read_limited
from multilica.errors import SourceNotFoundError, UnfitRunError, UnreadableSourceError, UsageError, listed
from multilica.exports import read_extrinsics
from multilica.extrinsics import Extrinsics, read_extrinsics_table
from multilica.geometry import RigidTransform
from multilica.runs.run_documents import is_run, read_run, read_run_document, saved_run
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.files.result_files import CALIBRATION_TOML


def require_reference(path: Path) -> None:
    """Raise SourceNotFoundError if there is no reference."""
    if not path.exists():
        raise SourceNotFoundError(f"No reference at {path}; give a calibration.toml, a run, or another file of poses.")


def require_known_lidars(path: Path, tolerances: RigTolerances, named: Collection[str] = ()) -> None:
    """Raise UsageError if a LiDAR has a tolerance, yet is neither in the reference nor among those that are named.

    Errors of a reference that cannot be read are those of `poses_of`.
    """
    if not tolerances.lidars:
        return
    # Without a pose that is certain, a LiDAR is still one of the vehicle.
    known = (
        {*read_run_document(path).document.lidars}
        if is_run(path)
        else read_extrinsics(path, with_uncertain=True).members
    )
    if unknown := sorted({*tolerances.lidars} - known - {*named}):
        raise UsageError(
            f"There is a tolerance for '{unknown[0]}', which {path} does not have; expected one of "
            f"{listed(sorted(known))}."
        )


def poses_of(path: Path) -> Extrinsics:
    """Read the poses of the placed LiDARs of a run, or of any file that `read_extrinsics` takes.

    Raises:
        SourceNotFoundError: there is nothing.
        UnreadableSourceError: it is damaged, or holds no poses.
    """
    require_reference(path)
    if not is_run(path):
        return read_extrinsics(path)
    run = read_run_document(path)
    saved_run(run, str(path))  # refuses a damaged covariance
    document = run.document
    placed = {name: pose for name, pose in document.poses.items() if name in document.placed}
    if not placed:
        raise UnreadableSourceError(f"{path} places no LiDAR; a reference needs a run that does.")
    return Extrinsics(document.target, placed, covariances=document.covariances)


def read_reference(path: Path, frame_ids: Mapping[str, str]) -> Extrinsics:
    """Read the poses of LiDARs from a run, or from any file that `read_extrinsics` takes.

    Args:
        frame_ids: of the LiDARs that are checked, by name; a file may have a LiDAR by either.

    Raises:
        SourceNotFoundError: there is nothing.
        UnreadableSourceError: it is damaged, or holds no extrinsics.
        UsageError: it has fewer than two of the LiDARs.
    """
    found = poses_of(path)
    named = {
        name: next(known for known in (name, frame_id) if known in found.members)
        for name, frame_id in frame_ids.items()
        if {name, frame_id} & found.members
    }
    if len(named) < 2:
        asked = [f"{name} ({frame})" if frame and frame != name else name for name, frame in frame_ids.items()]
        raise UsageError(
            f"{path} has poses of {', '.join(sorted(found.members))}; a check needs two or more of {', '.join(asked)}."
        )
    if found.covariances:
        return _renamed(found, named)
    root = next(iter(named))
    poses = {name: found.between(named[root], known).matrix for name, known in named.items()}
    return Extrinsics(root, {name: RigidTransform(root, name, pose) for name, pose in poses.items()})


def _renamed(found: Extrinsics, named: Mapping[str, str]) -> Extrinsics:
    """Return poses and covariances under other names; `named` has the present one of each."""
    target = next((name for name, known in named.items() if known == found.target), found.target)
    others = {name: known for name, known in named.items() if name != target}
    poses = {name: found.between(found.target, known).matrix for name, known in others.items()}
    return Extrinsics(
        target,
        {name: RigidTransform(target, name, pose) for name, pose in poses.items()},
        covariances={name: value for name, known in others.items() if (value := found.covariance(known)) is not None},
    )


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
    without = [each.lidar for each in run.placements if each.T_target_source is None or each.uncertain]
    if without:
        raise UnfitRunError(
            f"{directory} does not place {', '.join(without)}; accept a run that places every LiDAR "
            f"(`multilica explain {directory}` says what would help)."
        )
    if undone := next((knock for knock in run.knocks if knock.is_undone), None):
        raise UnfitRunError(
            f"{directory} has the pose of {undone.lidar} before it moved: {undone.motion}; accept a run of the stops "
            "after that."
        )
    used = [each for each in run.snapshots if not each.refusal]
    if len(used) > 1 and used[-1].outliers:
        raise UnfitRunError(
            f"{directory} has poses that its last snapshot contradicts ({used[-1].name}: {used[-1].text}): "
            f"{listed(list(used[-1].outliers))} may have moved; accept a run of the snapshots since then, or one "
            "without that snapshot."
        )
    new = read_extrinsics_table(file)
    before = None
    if into.exists():
        old = read_extrinsics_table(into)
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
    into.parent.mkdir(parents=True, exist_ok=True)
    write_text_atomically(into, read_limited(file, MAX_TOML_BYTES).decode("utf-8"))
    return before
