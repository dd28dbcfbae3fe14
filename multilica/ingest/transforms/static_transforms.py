# SPDX-License-Identifier: Apache-2.0
"""The static transforms of a recording."""

import math
from collections.abc import Iterator
from contextlib import closing
from itertools import islice

import numpy as np

from multilica.documents import MAX_LENGTH_M
from multilica.geometry import RigidTransform
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import RawMessage, Recording

StaticTransforms = tuple[tuple[RigidTransform, ...], tuple[str, ...]]
"""Transforms sorted by parent and child, notes on those that were left out."""

_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_ENCODINGS = ("cdr", "ros1")
_MAX_MESSAGES = 256
_MAX_REPEATS = 10
_QUIET_NS = 2 * 10**9
"""After that many repetitions over that time, stop reading: each one costs a chunk of the recording."""
_NORM_TOLERANCE = 0.01


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
