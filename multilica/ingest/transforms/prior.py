# SPDX-License-Identifier: Apache-2.0
"""Prior poses of LiDARs from a file or from the static transforms of a recording."""

import math
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np

from multilica.documents import MAX_LENGTH_M
from multilica.errors import SourceNotFoundError, UnfitPriorError, UsageError
from multilica.extrinsics import Extrinsics, read_extrinsics_table
from multilica.geometry import RigidTransform
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import DamagedRecordingError, RawMessage, Recording
from multilica.ingest.transforms.urdf import Joint, read_urdf
from multilica.snapshot import Snapshot

STATIC_TRANSFORMS = "tf"
_URDF_SUFFIXES = (".urdf", ".xml", ".xacro")
_MAX_FRAMES = 12
_EXPECTED = "expected 'tf', a .toml file of extrinsics or a .urdf file"

StaticTransforms = tuple[tuple[RigidTransform, ...], tuple[str, ...]]
"""Transforms sorted by parent and child, notes on those that were left out."""

_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_ENCODINGS = ("cdr", "ros1")
_MAX_MESSAGES = 256
_MAX_REPEATS = 10
_QUIET_NS = 2 * 10**9
"""After that many repetitions over that time, stop reading: each one costs a chunk of the recording."""
_NORM_TOLERANCE = 0.01


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
            URDF file, or poses that were read. Uncertain LiDARs of a `calibration.toml` are included: each pose of
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
        return _fixed(read_extrinsics_table(path, with_uncertain=True))
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


def read_static_transforms(recording: Recording) -> StaticTransforms:
    """Read the static transforms with the parent frame as target; the latest one if a transform changes.

    Reading stops when the publishers only repeat themselves.
    """
    topics = [
        topic.name
        for topic in recording.topics
        if topic.message_type in _TYPES and topic.encoding in _ENCODINGS and topic.name.endswith("tf_static")
    ]
    if not topics:
        return (), ()
    found: dict[tuple[str, str], RigidTransform] = {}
    notes: dict[str, None] = {}
    repeats, news_ns = 0, 0
    try:
        with closing(recording.messages(topics)) as messages:
            # Another type may be recorded under the same name.
            transforms = (message for message in messages if message.message_type in _TYPES)
            for message in islice(transforms, _MAX_MESSAGES):
                if _add(message, found, notes):
                    repeats, news_ns = 0, message.log_time_ns
                repeats += 1
                if repeats > _MAX_REPEATS and message.log_time_ns - news_ns >= _QUIET_NS:
                    break
    except DamagedRecordingError as error:
        notes[f"'{topics[0]}' was only read in part: {error.reason}."] = None
    return tuple(found[key] for key in sorted(found)), tuple(notes)


def _add(message: RawMessage, found: dict[tuple[str, str], RigidTransform], notes: dict[str, None]) -> bool:
    """Add the transforms of a message; return whether any of them is new."""
    try:
        stamped = tuple(_stamped_transforms(message))
    except ValueError as error:
        notes[f"A message on '{message.topic}' was left out: it {error}."] = None
        return False
    is_news = False
    for parent, child, values in stamped:
        try:
            transform = _rigid(parent, child, values)
        except ValueError as error:
            notes[f"A transform on '{message.topic}' was left out: {error}."] = None
        else:
            key = transform.target, transform.source
            is_news |= key not in found or not np.array_equal(found[key].matrix, transform.matrix)
            found[key] = transform
    return is_news


def _stamped_transforms(message: RawMessage) -> Iterator[tuple[str, str, tuple[float, ...]]]:
    """Read parent, child, and x, y, z, qx, qy, qz, qw of each ``geometry_msgs/TransformStamped``."""
    # Building the message types of `rosbags` would take longer than everything else that a small recording needs.
    reader = WireReader.of_message(message)
    for _ in range(reader.uint32()):
        _, parent = reader.header()
        yield parent, reader.text().strip("/"), reader.float64s(7)


def _rigid(parent: str, child: str, values: tuple[float, ...]) -> RigidTransform:
    if not parent or not child or parent == child:
        raise ValueError(f"its frames are '{parent}' and '{child}'; expected two different names")
    xyz_m, quaternion_xyzw = values[:3], values[3:]
    if not all(abs(value_m) <= MAX_LENGTH_M for value_m in xyz_m):
        raise ValueError(f"'{child}' in '{parent}' has the translation {xyz_m}; expected metres up to {MAX_LENGTH_M:g}")
    norm = math.hypot(*quaternion_xyzw)
    if not abs(norm - 1.0) < _NORM_TOLERANCE:
        raise ValueError(f"'{child}' in '{parent}' has a quaternion of length {norm:.3g}; expected 1")
    return RigidTransform.from_xyz_quaternion(parent, child, xyz_m, quaternion_xyzw)
