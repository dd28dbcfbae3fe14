# SPDX-License-Identifier: Apache-2.0
"""`/tf_static`: where the recording says that the sensors sit."""

from __future__ import annotations

import math
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
"""A publisher that repeats itself for hours says nothing new."""
_NORM_TOLERANCE = 0.01


def read_static_transforms(recording: Recording) -> StaticTransforms:
    """Every static transform of the recording, parent frame as target; the latest where one is repeated."""
    topics = [
        topic.name
        for topic in recording.topics
        if topic.message_type in _TYPES and topic.encoding in _ENCODINGS and topic.name.endswith("tf_static")
    ]
    if not topics:
        return (), ()
    found: dict[tuple[str, str], RigidTransform] = {}
    notes: dict[str, None] = {}
    try:
        for message in islice(recording.messages(topics), _MAX_MESSAGES):
            _add(message, found, notes)
    except DamagedRecordingError as error:
        notes[f"'{topics[0]}' was read in part only: {error.reason}."] = None
    return tuple(found[key] for key in sorted(found)), tuple(notes)


def _add(message: Message, found: dict[tuple[str, str], RigidTransform], notes: dict[str, None]) -> None:
    from multilica.ingest.ros_messages import unpacked

    try:
        stamped = unpacked(message).transforms
    except ValueError as error:
        notes[f"A message on '{message.topic}' was left out: it {error}."] = None
        return
    for entry in stamped:
        try:
            transform = _rigid(entry)
        except ValueError as error:
            notes[f"A transform on '{message.topic}' was left out: {error}."] = None
        else:
            found[transform.target, transform.source] = transform


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
