# SPDX-License-Identifier: Apache-2.0
"""`/tf_static`: where the recording says that the sensors sit."""

from __future__ import annotations

import math
from contextlib import closing
from itertools import islice
from typing import Any

import numpy as np

from multilica.geometry import RigidTransform
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Recording

__all__ = ["StaticTransforms", "read_static_transforms"]

StaticTransforms = tuple[tuple[RigidTransform, ...], tuple[str, ...]]
"""Transforms by (parent, child), notes on those that were left out."""

_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_ENCODINGS = ("cdr", "ros1")
_MAX_MESSAGES = 256
_MAX_REPEATS = 10
_QUIET_NS = 2 * 10**9
"""What was repeated so often, for so long, will be repeated to the end; each time costs a chunk of the recording."""
_NORM_TOLERANCE = 0.01


def read_static_transforms(recording: Recording) -> StaticTransforms:
    """The static transforms of the recording, parent frame as target; the latest where one changes.

    Where the publishers repeat themselves, what comes after some repetitions is not read.
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
            for message in islice(messages, _MAX_MESSAGES):
                if _add(message, found, notes):
                    repeats, news_ns = 0, message.log_time_ns
                repeats += 1
                if repeats > _MAX_REPEATS and message.log_time_ns - news_ns >= _QUIET_NS:
                    break
    except DamagedRecordingError as error:
        notes[f"'{topics[0]}' was read in part only: {error.reason}."] = None
    return tuple(found[key] for key in sorted(found)), tuple(notes)


def _add(message: Message, found: dict[tuple[str, str], RigidTransform], notes: dict[str, None]) -> bool:
    """Whether it says anything that was not known before."""
    from multilica.ingest.ros_messages import unpacked

    try:
        stamped = unpacked(message).transforms
    except ValueError as error:
        notes[f"A message on '{message.topic}' was left out: it {error}."] = None
        return False
    is_news = False
    for entry in stamped:
        try:
            transform = _rigid(entry)
        except ValueError as error:
            notes[f"A transform on '{message.topic}' was left out: {error}."] = None
        else:
            key = transform.target, transform.source
            is_news |= key not in found or not np.array_equal(found[key].matrix, transform.matrix)
            found[key] = transform
    return is_news


def _rigid(stamped: Any) -> RigidTransform:  # noqa: ANN401 - the class is made by rosbags at run time
    parent, child = stamped.header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
    if not parent or not child or parent == child:
        raise ValueError(f"its frames are '{parent}' and '{child}'; expected two different names")
    shift, turn = stamped.transform.translation, stamped.transform.rotation
    xyz_m = np.array([shift.x, shift.y, shift.z])
    quaternion_xyzw = np.array([turn.x, turn.y, turn.z, turn.w])
    if not np.isfinite(xyz_m).all():
        raise ValueError(f"'{child}' in '{parent}' has a translation that is not finite")
    norm = math.hypot(*quaternion_xyzw.tolist())
    if not abs(norm - 1.0) < _NORM_TOLERANCE:
        raise ValueError(f"'{child}' in '{parent}' has a quaternion of length {norm:.3g}; expected 1")
    return RigidTransform.from_xyz_quaternion(parent, child, xyz_m.tolist(), quaternion_xyzw.tolist())
