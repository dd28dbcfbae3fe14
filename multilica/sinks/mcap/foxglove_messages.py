# SPDX-License-Identifier: Apache-2.0
"""Messages in Foxglove's schemas."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove import messages
from foxglove.messages import (
    FrameTransform,
    FrameTransforms,
    Log,
    LogLevel,
    PackedElementField,
    PackedElementFieldNumericType,
    PointCloud,
    Pose,
    Quaternion,
    SceneUpdate,
    Timestamp,
    Vector3,
)
from mcap.well_known import MessageEncoding, SchemaEncoding

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY
from multilica.sinks.drawing.primitives import Drawing
from multilica.sinks.mcap.foxglove_scene import scene_update
from multilica.sinks.mcap.messages import McapMessage, MessageSchema
from multilica.sinks.text.log_lines import LogLine
from multilica.snapshot import Float32Array

__all__ = ["FoxgloveEncoding"]

_LEVELS = {"DEBUG": LogLevel.Debug, "INFO": LogLevel.Info, "WARN": LogLevel.Warning, "ERROR": LogLevel.Error}

_TEXT, _NUMBER, _FLAG = {"type": "string"}, {"type": "number"}, {"type": "boolean"}
_NUMBERS = {"type": "array", "items": _NUMBER}
_LIDAR_FIGURES = {
    "name": _TEXT,
    "placed": _FLAG,
    "xyz_m": _NUMBERS,
    "rpy_deg": _NUMBERS,
    "fitness": _NUMBER,
    "rmse_m": _NUMBER,
}
# Foxglove does not read objects with open keys: hence lists of named entries.
_METRICS_SCHEMA = {
    "title": "multilica.Metrics",
    "type": "object",
    "properties": {
        "status": _TEXT,
        "target": _TEXT,
        "placed": {"type": "integer"},
        "lidars": {"type": "array", "items": {"type": "object", "properties": _LIDAR_FIGURES}},
        "stages": {"type": "array", "items": {"type": "object", "properties": {"name": _TEXT, "duration_s": _NUMBER}}},
    },
}


class FoxgloveEncoding:
    """Protobuf messages with Foxglove's schemas; metrics as JSON."""

    profile = ""

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.FrameTransforms`` on `/tf`."""
        transforms = FrameTransforms(transforms=[_transform(pose, stamp_ns) for pose in poses])
        return McapMessage("/tf", _schema(FrameTransforms), transforms.encode())

    def cloud(self, lidar: str, points_m: Float32Array, stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.PointCloud`` of little-endian float32."""
        packed = np.ascontiguousarray(points_m, dtype="<f4")
        numeric = PackedElementFieldNumericType.Float32
        cloud = PointCloud(
            timestamp=_timestamp(stamp_ns),
            frame_id=lidar,
            pose=Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)),
            point_stride=packed.itemsize * 3,
            fields=[PackedElementField(name=name, offset=4 * index, type=numeric) for index, name in enumerate("xyz")],
            data=packed.tobytes(),
        )
        return McapMessage(f"/lidar/{lidar}/points", _schema(PointCloud), cloud.encode(), {LIDAR_NAME_KEY: lidar})

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.SceneUpdate``, an entity per drawing."""
        update = scene_update(drawings, _timestamp(stamp_ns))
        return McapMessage(topic, _schema(SceneUpdate), update.encode())

    def log(self, line: LogLine, stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.Log`` on `/log`."""
        entry = Log(
            timestamp=_timestamp(stamp_ns),
            level=_LEVELS[line.level],
            message=line.text,
            name="multilica",
            file="",
            line=0,
        )
        return McapMessage("/log", _schema(Log), entry.encode())

    def metrics(self, figures: Mapping[str, Any]) -> McapMessage:
        """Encode JSON with its own schema on `/metrics`."""
        schema = MessageSchema(
            "multilica.Metrics", SchemaEncoding.JSONSchema, json.dumps(_METRICS_SCHEMA).encode(), MessageEncoding.JSON
        )
        return McapMessage("/metrics", schema, json.dumps(figures, allow_nan=False).encode())


def _schema(
    kind: type[messages.FrameTransforms | messages.PointCloud | messages.SceneUpdate | messages.Log],
) -> MessageSchema:
    schema = kind.get_schema()
    return MessageSchema(schema.name, schema.encoding, schema.data, MessageEncoding.Protobuf)


def _timestamp(stamp_ns: int) -> Timestamp:
    return Timestamp(*divmod(stamp_ns, 10**9))


def _transform(pose: RigidTransform, stamp_ns: int) -> FrameTransform:
    x, y, z = pose.xyz_m.tolist()
    qx, qy, qz, qw = pose.quaternion_xyzw.tolist()
    return FrameTransform(
        timestamp=_timestamp(stamp_ns),
        parent_frame_id=pose.target,
        child_frame_id=pose.source,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
