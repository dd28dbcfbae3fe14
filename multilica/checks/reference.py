# SPDX-License-Identifier: Apache-2.0
"""Reference extrinsics of a check."""

from collections.abc import Mapping
from pathlib import Path

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.exports import read_extrinsics
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.runs.run_documents import is_run, read_run_document


def poses_of(path: Path) -> Extrinsics:
    """Read the poses of the placed LiDARs of a run, or of any file that `read_extrinsics` takes.

    Raises:
        SourceNotFoundError: there is nothing.
        UnreadableSourceError: it is damaged, or holds no poses.
    """
    if not path.exists():
        raise SourceNotFoundError(f"No reference at {path}; give a calibration.toml, a run, or another file of poses.")
    if not is_run(path):
        return read_extrinsics(path)
    document = read_run_document(path).document
    placed = {name: pose for name, pose in document.poses.items() if name in document.placed}
    if not placed:
        raise UnreadableSourceError(f"{path} places no LiDAR; a reference needs a run that does.")
    return Extrinsics(document.target, placed)


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
    root = next(iter(named))
    poses = {name: found.between(named[root], known).matrix for name, known in named.items()}
    return Extrinsics(root, {name: RigidTransform(root, name, pose) for name, pose in poses.items()})
