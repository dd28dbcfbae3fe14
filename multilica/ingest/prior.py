# SPDX-License-Identifier: Apache-2.0
"""Where a file or the recording itself claims that the LiDARs sit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from multilica.errors import SourceNotFoundError, UnfitPriorError, UsageError
from multilica.extrinsics import Extrinsics, read_extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.frame_tree import FrameTree, Joint, Sight
from multilica.ingest.urdf import read_urdf
from multilica.snapshot import LidarScans, Snapshot

__all__ = ["STATIC_TRANSFORMS", "Prior", "read_prior"]

STATIC_TRANSFORMS = "tf"
_URDF_SUFFIXES = (".urdf", ".xml", ".xacro")
_SHOWN_FRAMES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Claimed poses of a snapshot's LiDARs.

    Args:
        extrinsics: by the LiDARs' names, the first of them as the common frame.
        notes: what the user should know ("tf has no pose of rear").
    """

    extrinsics: Extrinsics
    notes: tuple[str, ...] = ()


def read_prior(source: str, snapshot: Snapshot) -> Prior:
    """Look the snapshot's LiDARs up, each by its name, else by its frame id.

    Args:
        source: ``tf`` for the recording's own static transforms, else a file: TOML as `calibration.toml` or a truth
            file is, or URDF.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: broken, or not what its name says.
        UnfitPriorError: fewer than two of the LiDARs hang together in it, or a joint between two of them moves.
        UsageError: a file of neither kind.
    """
    where = "The recording's /tf_static" if source == STATIC_TRANSFORMS else source
    tree = _read_tree(source, snapshot)
    frames = _frames_of_lidars(tree, snapshot.lidars)
    seen = _largest_rig(tree, frames)
    if len(seen) < 2:
        raise UnfitPriorError(_too_few(where, snapshot, frames, tree))
    for sight in seen.values():
        _require_fixed(where, sight)
    root = next(iter(seen))
    poses = {name: RigidTransform(root, name, sight.T_target_source.matrix) for name, sight in seen.items()}
    return Prior(Extrinsics(root, poses), _notes(where, snapshot, frames, seen))


def _read_tree(source: str, snapshot: Snapshot) -> FrameTree:
    if source == STATIC_TRANSFORMS:
        return FrameTree(tuple(Joint(pose) for pose in snapshot.static_transforms))
    path = Path(source)
    if path.suffix in _URDF_SUFFIXES:
        return read_urdf(path)
    if path.suffix == ".toml":
        poses = read_extrinsics(path).T_target_source.values()
        return FrameTree(tuple(Joint(pose) for pose in poses if pose.target != pose.source))
    if not path.exists():
        raise SourceNotFoundError(f"No prior at {path}; expected 'tf', a .toml file of extrinsics or a .urdf file.")
    raise UsageError(
        f"The prior {path} is of no known kind; expected 'tf', a .toml file of extrinsics or a .urdf file."
    )


def _frames_of_lidars(tree: FrameTree, lidars: tuple[LidarScans, ...]) -> dict[str, str]:
    """LiDAR -> frame, for those that the tree has."""
    found = {}
    for lidar in lidars:
        frame = next((name for name in (lidar.name, lidar.frame_id) if name in tree.frames), None)
        if frame is not None:
            found[lidar.name] = frame
    return found


def _largest_rig(tree: FrameTree, frames: Mapping[str, str]) -> dict[str, Sight]:
    """The most LiDARs that hang together, as the first of them by name sees them."""
    best: dict[str, Sight] = {}
    for frame in frames.values():
        seen = tree.seen_from(frame)
        rig = {name: seen[other] for name, other in frames.items() if other in seen}
        best = rig if len(rig) > len(best) else best
    return best


def _require_fixed(where: str, sight: Sight) -> None:
    if sight.moving is not None:
        one, other = sight.T_target_source.target, sight.T_target_source.source
        raise UnfitPriorError(
            f"{where} joins the LiDAR frames '{one}' and '{other}' through '{sight.moving.name}', "
            f"a {sight.moving.kind} joint; a prior needs fixed joints between LiDARs."
        )


def _too_few(where: str, snapshot: Snapshot, frames: Mapping[str, str], tree: FrameTree) -> str:
    shown = ", ".join(tree.frames[:_SHOWN_FRAMES]) or "none"
    more = f" and {len(tree.frames) - _SHOWN_FRAMES} more" if len(tree.frames) > _SHOWN_FRAMES else ""
    apart = " that nothing joins" if len(frames) > 1 else ""
    return (
        f"{where} has {len(frames)} of the LiDARs {', '.join(snapshot.names)}{apart}; a prior needs two or more "
        f"that are joined, by name or by frame id; its frames: {shown}{more}."
    )


def _notes(where: str, snapshot: Snapshot, frames: Mapping[str, str], seen: Mapping[str, Sight]) -> tuple[str, ...]:
    lacking = [name for name in snapshot.names if name not in frames]
    apart = [name for name in frames if name not in seen]
    notes = []
    if lacking:
        notes.append(f"{where} has no pose of {', '.join(lacking)}: calibrated without a prior.")
    if apart:
        notes.append(f"{where} does not join {', '.join(apart)} to {', '.join(seen)}: calibrated without a prior.")
    return tuple(notes)
