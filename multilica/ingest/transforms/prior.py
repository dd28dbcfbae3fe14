# SPDX-License-Identifier: Apache-2.0
"""Prior poses of LiDARs from a file or from the recording's static transforms."""

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from multilica.errors import SourceNotFoundError, UnfitPriorError, UsageError
from multilica.extrinsics import Extrinsics, read_extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.transforms.urdf import Joint, read_urdf
from multilica.snapshot import Snapshot

STATIC_TRANSFORMS = "tf"
_URDF_SUFFIXES = (".urdf", ".xml", ".xacro")
_MAX_FRAMES = 12
_EXPECTED = "expected 'tf', a .toml file of extrinsics or a .urdf file"


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Prior poses of a snapshot's LiDARs.

    Args:
        extrinsics: by the LiDARs' names, with the first of them as the common frame.
        notes: what the user should know ("tf has no pose of rear").
    """

    extrinsics: Extrinsics
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """The pose of a frame with every joint at rest, and the first joint up to it that is not fixed."""

    T_target_source: RigidTransform
    moving: Joint | None = None


def read_prior(source: str | Extrinsics, snapshot: Snapshot) -> Prior:
    """Find the poses of the snapshot's LiDARs by name, else by frame id.

    Args:
        source: ``tf`` for the recording's static transforms, a TOML file like `calibration.toml` or a truth file, a
            URDF file, or poses that were read. Uncertain LiDARs of a `calibration.toml` are taken as well: each pose of
            a prior is tested.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is broken, or not what its name says.
        UnfitPriorError: it connects fewer than two of the LiDARs, or a joint between two of them moves.
        UsageError: the file is of another kind.
    """
    where = "The recording's /tf_static" if source == STATIC_TRANSFORMS else str(source)
    if isinstance(source, Extrinsics):
        where = "The prior"
    joints = _read_joints(source, snapshot)
    ends = ((joint.T_parent_child.target, joint.T_parent_child.source) for joint in joints)
    known = sorted(set(chain.from_iterable(ends)))
    frames = {
        lidar.name: frame
        for lidar in snapshot.lidars
        if (frame := next((name for name in (lidar.name, lidar.frame_id) if name in known), None)) is not None
    }
    poses = _largest_rig(joints, frames)
    if len(poses) < 2:
        raise UnfitPriorError(_too_few(where, snapshot, frames, known))
    for pose in poses.values():
        if pose.moving is not None:
            raise UnfitPriorError(
                f"{where} joins the LiDAR frames '{pose.T_target_source.target}' and '{pose.T_target_source.source}' "
                f"through '{pose.moving.name}', a {pose.moving.kind} joint; a prior needs fixed joints between LiDARs."
            )
    root = next(iter(poses))
    transforms = {name: RigidTransform(root, name, pose.T_target_source.matrix) for name, pose in poses.items()}
    return Prior(Extrinsics(root, transforms), tuple(_notes(where, snapshot, frames, poses)))


def _read_joints(source: str | Extrinsics, snapshot: Snapshot) -> tuple[Joint, ...]:
    if isinstance(source, Extrinsics):
        return _fixed(source)
    if source == STATIC_TRANSFORMS:
        return tuple(Joint(pose) for pose in snapshot.static_transforms)
    path = Path(source)
    if path.suffix in _URDF_SUFFIXES:
        return read_urdf(path)
    if path.suffix == ".toml":
        return _fixed(read_extrinsics(path, with_uncertain=True))
    if not path.exists():
        raise SourceNotFoundError(f"No prior at {path}; {_EXPECTED}.")
    raise UsageError(f"The prior {path} is of an unknown kind; {_EXPECTED}.")


def _fixed(known: Extrinsics) -> tuple[Joint, ...]:
    return tuple(Joint(pose) for pose in known.T_target_source.values() if pose.target != pose.source)


def _largest_rig(joints: Sequence[Joint], frames: Mapping[str, str]) -> dict[str, FramePose]:
    """Return the poses of the most LiDARs that are connected, relative to the first of them."""
    best: dict[str, FramePose] = {}
    for frame in frames.values():
        poses = poses_from(frame, joints)
        rig = {name: poses[other] for name, other in frames.items() if other in poses}
        best = rig if len(rig) > len(best) else best
    return best


def poses_from(frame: str, joints: Iterable[Joint]) -> dict[str, FramePose]:
    """Return the pose of every frame that is connected with `frame`, itself included, over the fewest joints."""
    steps: dict[str, list[tuple[RigidTransform, Joint]]] = defaultdict(list)
    for joint in joints:
        for step in (joint.T_parent_child, joint.T_parent_child.inverse()):
            steps[step.target].append((step, joint))
    found = {frame: FramePose(RigidTransform.identity(frame, frame))}
    queue = deque([frame])
    while queue:
        here = queue.popleft()
        for step, joint in steps[here]:
            if step.source not in found:
                moving = found[here].moving or (None if joint.kind == "fixed" else joint)
                found[step.source] = FramePose(found[here].T_target_source @ step, moving)
                queue.append(step.source)
    return found


def _too_few(where: str, snapshot: Snapshot, frames: Mapping[str, str], known: Sequence[str]) -> str:
    listed = ", ".join(known[:_MAX_FRAMES]) or "none"
    more = f" and {len(known) - _MAX_FRAMES} more" if len(known) > _MAX_FRAMES else ""
    apart = ", which are not connected" if len(frames) > 1 else ""
    return (
        f"{where} has {len(frames)} of the LiDARs {', '.join(snapshot.names)}{apart}; a prior needs two or more that "
        f"are connected, by name or by frame id; its frames: {listed}{more}."
    )


def _notes(where: str, snapshot: Snapshot, frames: Mapping[str, str], poses: Mapping[str, FramePose]) -> list[str]:
    missing = [name for name in snapshot.names if name not in frames]
    apart = [name for name in frames if name not in poses]
    notes = []
    if missing:
        notes.append(f"{where} has no pose of {', '.join(missing)}")
    if apart:
        notes.append(f"{where} does not connect {', '.join(apart)} with {', '.join(poses)}")
    return [f"{note}: calibrated without a prior." for note in notes]
