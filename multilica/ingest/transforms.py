# SPDX-License-Identifier: Apache-2.0
"""Poses before calibration: static transforms of a recording, joints of a URDF file, priors from either."""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from multilica.documents import MAX_LENGTH_M, read_limited, require_length
from multilica.errors import SourceNotFoundError, UnfitPriorError, UnreadableSourceError, UsageError
from multilica.extrinsics import Extrinsics, read_extrinsics_table
from multilica.geometry import RigidTransform
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import DamagedRecordingError, RawMessage, Recording
from multilica.snapshot import Snapshot

STATIC_TRANSFORMS = "tf"
_MAX_FRAMES = 12
_OF_TF = (
    " Poses on /tf are read only if a static publisher of ROS 1 repeats them; give others as a .toml or .urdf file."
)
_EXPECTED = "expected 'tf', a .toml file of extrinsics or a .urdf file"

StaticTransforms = tuple[tuple[RigidTransform, ...], tuple[str, ...]]
"""Transforms sorted by parent and child, notes on those that were left out."""

_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_MAX_REPEATS = 10
_QUIET_NS = 2 * 10**9
"""After that many repetitions over that time, stop reading: each one costs a chunk of the recording."""
_MOST_MESSAGES = 256
_REPEATED_NS = 5 * 10**9
"""Publishers on ROS 1's `/tf` repeat static transforms every 0.1 s, at most every few seconds."""
_NORM_TOLERANCE = 0.01


_MAX_URDF_BYTES = 4 << 20
"""A description without its meshes takes a few hundred kilobytes; as elements, each byte takes a hundred."""
_MAX_URDF_DEPTH = 64
MAX_ANGLE_RAD = 6.29
"""A full turn, rounded up: larger angles are degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """The connection of a child frame to its parent; `kind` is ``"fixed"``, or how it moves."""

    T_parent_child: RigidTransform
    name: str = ""
    kind: str = "fixed"


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
    titles = {STATIC_TRANSFORMS: "The recording's /tf_static"}
    where = "The prior" if isinstance(source, Extrinsics) else titles.get(source, source)
    joints = _read_joints(source, snapshot)
    ends = ((joint.T_parent_child.target, joint.T_parent_child.source) for joint in joints)
    known = sorted(set(chain.from_iterable(ends)))
    frames = {
        lidar.name: frame
        for lidar in snapshot.lidars
        if (frame := next((name for name in (lidar.name, lidar.frame_id) if name in known), None)) is not None
    }
    connected = {frame: poses_from(frame, joints) for frame in frames.values()}
    rigs = [{name: poses[other] for name, other in frames.items() if other in poses} for poses in connected.values()]
    poses = max(rigs, key=len, default={})  # relative to the first of them
    if len(poses) < 2:
        raise UnfitPriorError(
            _too_few(where, snapshot, frames, known) + (_OF_TF if source == STATIC_TRANSFORMS else "")
        )
    for pose in poses.values():
        if pose.moving is not None:
            raise UnfitPriorError(
                f"{where} joins the LiDAR frames '{pose.T_target_source.target}' and '{pose.T_target_source.source}' "
                f"through '{pose.moving.name}', a {pose.moving.kind} joint; a prior needs fixed joints between LiDARs."
            )
    root, *_ = poses
    transforms = {name: RigidTransform(root, name, pose.T_target_source.matrix) for name, pose in poses.items()}
    missing = ", ".join(name for name in snapshot.names if name not in frames)
    apart = ", ".join(name for name in frames if name not in poses)
    notes = (
        *([f"{where} has no pose of {missing}"] if missing else []),
        *([f"{where} does not connect {apart} with {', '.join(poses)}"] if apart else []),
    )
    return Prior(Extrinsics(root, transforms), tuple(f"{note}: calibrated without a prior." for note in notes))


def _read_joints(source: str | Extrinsics, snapshot: Snapshot) -> tuple[Joint, ...]:
    if not isinstance(source, Extrinsics) and Path(source).suffix == ".toml":
        source = read_extrinsics_table(source, with_uncertain=True)
    if isinstance(source, Extrinsics):
        return tuple(Joint(pose) for pose in source.T_target_source.values() if pose.target != pose.source)
    if source == STATIC_TRANSFORMS:
        return tuple(Joint(pose) for pose in snapshot.static_transforms)
    path = Path(source)
    if path.suffix in (".urdf", ".xml", ".xacro"):
        return read_urdf(path)
    if not path.exists():
        raise SourceNotFoundError(f"No prior at {path}; {_EXPECTED}.")
    raise UsageError(f"The prior {path} is of an unknown kind; {_EXPECTED}.")


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


def read_static_transforms(recording: Recording) -> StaticTransforms:
    """Read the static transforms with the parent frame as target; the latest one if a transform changes.

    Reading stops when the publishers only repeat themselves. Frames without a parent there have the one that a static
    publisher of ROS 1 repeats on `/tf`.
    """
    topics = [
        topic.name
        for topic in recording.topics
        if topic.message_type in _TYPES and topic.encoding in ("cdr", "ros1") and topic.name.endswith("tf_static")
    ]
    found, notes = _read_latest(recording, topics) if topics else ({}, {})
    known = {child for _, child in found}
    found |= {ends: pose for ends, pose in _read_repeated(recording).items() if ends[1] not in known}
    parents: dict[str, list[str]] = defaultdict(list)
    for parent, child in sorted(found):
        parents[child].append(parent)
    notes |= {
        f"'{topics[0] if child in known else '/tf'}' gives '{child}' the parents {', '.join(several)}; expected one: "
        "remove the others.": None
        for child, several in parents.items()
        if len(several) > 1
    }
    return tuple(found[key] for key in sorted(found)), tuple(notes)


def _read_latest(
    recording: Recording, topics: Sequence[str]
) -> tuple[dict[tuple[str, str], RigidTransform], dict[str, None]]:
    found: dict[tuple[str, str], RigidTransform] = {}
    notes: dict[str, None] = {}
    repeats, news_ns = 0, 0
    try:
        with closing(recording.messages(topics)) as messages:
            # Another type may be recorded under the same name.
            transforms = (message for message in messages if message.message_type in _TYPES)
            for message in islice(transforms, _MOST_MESSAGES):
                if _add(message, found, notes):
                    repeats, news_ns = 0, message.log_time_ns
                repeats += 1
                if repeats > _MAX_REPEATS and message.log_time_ns - news_ns >= _QUIET_NS:
                    break
    except DamagedRecordingError as error:
        notes[f"'{topics[0]}' was only read in part: {error.reason}."] = None
    return found, notes


def _read_repeated(recording: Recording) -> dict[tuple[str, str], RigidTransform]:
    """Read what static publishers of ROS 1 repeat on `/tf`, from the beginning of a recording with an index.

    They date transforms ahead of time, so that these are valid until the next ones. Those of moving frames usually are
    not.
    """
    topics = [
        topic.name
        for topic in recording.topics
        if topic.message_type in _TYPES and topic.encoding == "ros1" and topic.name.rpartition("/")[2] == "tf"
    ]
    if not topics or not recording.is_indexed:
        return {}
    values: dict[tuple[str, str], list[tuple[float, ...] | None]] = defaultdict(list)
    start_ns = None
    with suppress(DamagedRecordingError), closing(recording.messages(topics)) as messages:
        for message in islice(messages, _MOST_MESSAGES):
            start_ns = message.log_time_ns if start_ns is None else start_ns
            if message.log_time_ns - start_ns > _REPEATED_NS:
                break
            with suppress(ValueError):
                for stamp_ns, parent, child, numbers in _stamped(message):
                    values[parent, child].append(numbers if stamp_ns > message.log_time_ns else None)
    found = {}
    for ends, given in values.items():
        first = given[0]
        if first is not None and len(given) > 1 and set(given) == {first}:
            with suppress(ValueError):
                found[ends] = _rigid(*ends, first)
    return found


def _add(message: RawMessage, found: dict[tuple[str, str], RigidTransform], notes: dict[str, None]) -> bool:
    """Add the transforms of a message; return whether any of them is new."""
    try:
        stamped = _stamped(message)
    except ValueError as error:
        notes[f"A message on '{message.topic}' was left out: it {error}."] = None
        return False
    is_news = False
    for _, parent, child, values in stamped:
        try:
            transform = _rigid(parent, child, values)
        except ValueError as error:
            notes[f"A transform on '{message.topic}' was left out: {error}."] = None
        else:
            key = transform.target, transform.source
            is_news |= key not in found or not np.array_equal(found[key].matrix, transform.matrix)
            found[key] = transform
    return is_news


def _stamped(message: RawMessage) -> list[tuple[int, str, str, tuple[float, ...]]]:
    """Return stamp in nanoseconds, parent, child, and translation and quaternion of each transform of a message."""
    # Building the message types of `rosbags` would take longer than everything else that a small recording needs.
    reader = WireReader.of_message(message)
    return [(*reader.header(), reader.text().strip("/"), reader.float64s(7)) for _ in range(reader.uint32())]


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


def read_urdf(path: Path) -> tuple[Joint, ...]:
    """Read every joint of a URDF file; ignore links without a joint and meshes.

    A joint's origin is ``T_parent_child``: xyz in metres, rpy in radians, extrinsic xyz; identity if it is missing.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is not XML or URDF, has xacro macros, or its joints are not a tree.
    """
    robot = parse_xml(path, "URDF")
    level = [robot]
    for _ in range(_MAX_URDF_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise UnreadableSourceError(
            f"{path} is not a valid URDF file: it is nested more than {_MAX_URDF_DEPTH} levels deep."
        )
    if path.suffix == ".xacro" or any("wiki/xacro}" in str(element.tag) for element in robot.iter()):
        raise UnreadableSourceError(
            f"{path} has xacro macros; run xacro first (xacro {path.name} > robot.urdf) and give its output."
        )
    if robot.tag != "robot":
        raise UnreadableSourceError(f"{path} begins with <{robot.tag}>; expected <robot>, as in a URDF file.")
    try:
        joints = tuple(_joint(element) for element in robot.findall("joint"))
    except ValueError as error:
        raise UnreadableSourceError(f"{path} is not a valid URDF file: {error}.") from error
    parents = Counter(joint.T_parent_child.source for joint in joints)
    link, count = next(iter(parents.most_common(1)), ("", 0))
    if count > 1:
        raise UnreadableSourceError(
            f"{path} is not a valid URDF file: link '{link}' is the child of {count} joints, expected one."
        )
    return joints


def parse_xml(path: Path, kind: str) -> Element:
    """Parse a small XML file without entities; `kind` is what it should be, for messages.

    Raises:
        SourceNotFoundError: there is no such file.
        UnreadableSourceError: it is not such a file.
    """
    try:
        return ElementTree.fromstring(read_limited(path, _MAX_URDF_BYTES))
    except FileNotFoundError as error:
        raise SourceNotFoundError(f"No {kind} file at {path}.") from error
    except DefusedXmlException as error:
        raise UnreadableSourceError(f"{path} defines XML entities; remove them, a {kind} file needs none.") from error
    except (OSError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise UnreadableSourceError(f"{path} is not a valid XML file: {error}.") from error


def _joint(element: Element) -> Joint:
    name = element.get("name", "")
    kind = element.get("type")
    if kind is None:
        raise ValueError(f"joint '{name}' has no type")
    ends = {end: element.find(end) for end in ("parent", "child")}
    links = {end: "" if entry is None else entry.get("link", "") for end, entry in ends.items()}
    if lacking := [end for end, link in links.items() if not link]:
        raise ValueError(f"joint '{name}' has no {lacking[0]} link")
    if links["parent"] == links["child"]:
        raise ValueError(f"joint '{name}' joins '{links['parent']}' to itself")
    origin = element.find("origin")
    if origin is not None and "quat_xyzw" in origin.attrib:
        raise ValueError(f"joint '{name}' has its rotation as quat_xyzw, expected rpy")
    xyz_m, rpy_rad = (_three(origin, key, name) for key in ("xyz", "rpy"))
    return Joint(RigidTransform.from_xyz_rpy(links["parent"], links["child"], xyz_m, rpy_rad), name, kind)


def _three(origin: Element | None, key: str, name: str) -> list[float]:
    text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
    try:
        numbers = [require_length(float(word)) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise ValueError(f"joint '{name}' has {key} '{text}', expected three numbers")
    if key == "rpy" and max(map(abs, numbers)) > MAX_ANGLE_RAD:
        raise ValueError(f"joint '{name}' has {key} '{text}', expected radians")
    return numbers
