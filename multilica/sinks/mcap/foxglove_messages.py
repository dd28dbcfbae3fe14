# SPDX-License-Identifier: Apache-2.0
"""Messages in Foxglove's schemas."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

from multilica.geometry import Float32Array, RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY
from multilica.sinks.drawing import Drawing, Ellipsoid, Label, Lines, Rgb
from multilica.sinks.mcap.messages import McapMessage, MessageSchema
from multilica.sinks.text.log_lines import LogLine

_LINE_PIXELS = 2.0
_TEXT_PIXELS = 14.0
_OPACITY = 0.6
_LEVELS = {"DEBUG": Log.DEBUG, "INFO": Log.INFO, "WARN": Log.WARNING, "ERROR": Log.ERROR}

_TEXT, _NUMBER, _FLAG = {"type": "string"}, {"type": "number"}, {"type": "boolean"}
_NUMBERS = {"type": "array", "items": _NUMBER}
_LIDAR_FIGURES = {
    "name": _TEXT,
    "placed": _FLAG,
    "status": _TEXT,
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
        "uncertain": {"type": "integer"},
        "lidars": {"type": "array", "items": {"type": "object", "properties": _LIDAR_FIGURES}},
        "stages": {"type": "array", "items": {"type": "object", "properties": {"name": _TEXT, "duration_s": _NUMBER}}},
    },
}


class FoxgloveEncoding:
    """Protobuf messages with Foxglove's schemas; metrics as JSON."""

    profile = ""

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.FrameTransforms`` on `/tf`."""
        transforms = [
            FrameTransform(
                timestamp=_timestamp(stamp_ns),
                parent_frame_id=pose.target,
                child_frame_id=pose.source,
                translation=_vector(pose.xyz_m.tolist()),
                rotation=_quaternion(pose.quaternion_xyzw.tolist()),
            )
            for pose in poses
        ]
        return McapMessage("/tf", _schema(FrameTransforms), FrameTransforms(transforms=transforms).SerializeToString())

    def cloud(self, lidar: str, frame_id: str, points_m: Float32Array, stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.PointCloud`` of little-endian float32."""
        packed = np.ascontiguousarray(points_m, dtype="<f4")
        numeric = PackedElementField.FLOAT32
        cloud = PointCloud(
            timestamp=_timestamp(stamp_ns),
            frame_id=frame_id,
            pose=_pose((0.0, 0.0, 0.0)),
            point_stride=packed.itemsize * 3,
            fields=[PackedElementField(name=name, offset=4 * index, type=numeric) for index, name in enumerate("xyz")],
            data=packed.tobytes(),
        )
        data, metadata = cloud.SerializeToString(), {LIDAR_NAME_KEY: lidar}
        return McapMessage(f"/lidar/{lidar}/points", _schema(PointCloud), data, metadata)

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.SceneUpdate``, an entity per drawing, which follows its frame."""
        entities = [
            SceneEntity(
                timestamp=_timestamp(stamp_ns),
                frame_id=drawing.frame_id,
                id=drawing.name,
                frame_locked=True,
                lines=[_lines(lines) for lines in drawing.lines],
                spheres=[_sphere(ellipsoid) for ellipsoid in drawing.ellipsoids],
                texts=[_text(label) for label in drawing.labels],
            )
            for drawing in drawings
        ]
        return McapMessage(topic, _schema(SceneUpdate), SceneUpdate(entities=entities).SerializeToString())

    def stop_poses(self, first: str, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.PosesInFrame``: poses in one frame, of the stops that links connect with the first one."""
        found = PosesInFrame(
            timestamp=_timestamp(stamp_ns),
            frame_id=poses[0].target,
            poses=[_pose(pose.xyz_m.tolist(), pose.quaternion_xyzw.tolist()) for pose in poses],
        )
        return McapMessage(f"/drive/{first}", _schema(PosesInFrame), found.SerializeToString())

    def log(self, line: LogLine, stamp_ns: int) -> McapMessage:
        """Encode ``foxglove.Log`` on `/log`."""
        level, stamp = _LEVELS[line.level], _timestamp(stamp_ns)
        entry = Log(timestamp=stamp, level=level, message=line.text, name="multilica", file="", line=0)
        return McapMessage("/log", _schema(Log), entry.SerializeToString())

    def metrics(self, figures: Mapping[str, Any]) -> McapMessage:
        """Encode JSON with its own schema on `/metrics`."""
        schema = MessageSchema(
            "multilica.Metrics", SchemaEncoding.JSONSchema, json.dumps(_METRICS_SCHEMA).encode(), MessageEncoding.JSON
        )
        return McapMessage("/metrics", schema, json.dumps(figures, allow_nan=False).encode())


@cache
def _schema(kind: type[FrameTransforms | PointCloud | PosesInFrame | SceneUpdate | Log]) -> MessageSchema:
    descriptors = build_file_descriptor_set(kind).SerializeToString()
    return MessageSchema(kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, descriptors, MessageEncoding.Protobuf)


def _timestamp(stamp_ns: int) -> Timestamp:
    seconds, nanos = divmod(stamp_ns, 10**9)
    return Timestamp(seconds=seconds, nanos=nanos)


def _lines(lines: Lines) -> LinePrimitive:
    primitive = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        pose=_pose((0.0, 0.0, 0.0)),
        thickness=_LINE_PIXELS,
        scale_invariant=True,
        color=_color(lines.colour),
    )
    add = primitive.points.add  # takes a third of the time of messages that are made first
    for x, y, z in lines.segments_m.reshape(-1, 3).tolist():
        add(x=x, y=y, z=z)
    return primitive


def _sphere(ellipsoid: Ellipsoid) -> SpherePrimitive:
    size = _vector((2.0 * ellipsoid.half_sizes_m).tolist())
    pose = _pose(ellipsoid.pose.xyz_m.tolist(), ellipsoid.pose.quaternion_xyzw.tolist())
    return SpherePrimitive(pose=pose, size=size, color=_color(ellipsoid.colour, _OPACITY))


def _text(label: Label) -> TextPrimitive:
    return TextPrimitive(
        pose=_pose(label.xyz_m.tolist()),
        billboard=True,
        font_size=_TEXT_PIXELS,
        scale_invariant=True,
        color=_color(label.colour),
        text=label.text,
    )


def _pose(xyz_m: Sequence[float], xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    return Pose(position=_vector(xyz_m), orientation=_quaternion(xyzw))


def _quaternion(xyzw: Sequence[float]) -> Quaternion:
    return Quaternion(**dict(zip("xyzw", xyzw, strict=True)))


def _vector(xyz: Sequence[float]) -> Vector3:
    return Vector3(**dict(zip("xyz", xyz, strict=True)))


def _color(colour: Rgb, opacity: float = 1.0) -> Color:
    red, green, blue = (channel / 255.0 for channel in colour)
    return Color(r=red, g=green, b=blue, a=opacity)
