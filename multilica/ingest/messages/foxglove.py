# SPDX-License-Identifier: Apache-2.0
"""The decoder of Foxglove's point clouds, as protocol buffers or JSON."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import pybase64
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf.message import DecodeError

from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage, sanitize_text
from multilica.pointcloud2 import PointCloud2, PointField, decode_points

_DATATYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
"""Foxglove's number types -> those of `PointField`; Foxglove lists the unsigned ones first."""
_DATA_KEY = re.compile(rb'"data"\s*:\s*"')
_DATA_END = re.compile(rb'"\s*}\s*\Z')
_TAIL_BYTES = 64
_POSE_TOLERANCE = 1e-9


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a ``foxglove.PointCloud``; points stay in the cloud's own frame, whatever its pose."""
    decode = _from_json if message.encoding == "json" else _from_protobuf
    stamp_ns, frame_id, pose, fields, stride, data = decode(message.data)
    width, rest = divmod(len(data), stride) if stride else (0, len(data))
    if rest:
        raise ValueError(f"holds {len(data)} bytes of points of {stride} bytes each")
    points = decode_points(PointCloud2(fields, width, 1, stride, len(data), data), timed=message.timed)
    frame_id = frame_id.strip("/")
    scan = points.as_scan(stamp_ns if stamp_ns > 0 else message.log_time_ns)
    x, y, z, qx, qy, qz, qw = pose
    turned = max(abs(qx), abs(qy), abs(qz)) > _POSE_TOLERANCE * max(1.0, abs(qw))
    if math.hypot(x, y, z) <= _POSE_TOLERANCE and not turned:
        return Cloud(scan, frame_id)
    remark = (
        f"gives its clouds a pose of their own in '{frame_id}'; the result is for the cloud's origin, not that frame"
    )
    return Cloud(scan, frame_id, remark)


_Parts = tuple[int, str, Sequence[float], tuple[PointField, ...], int, bytes]
"""Stamp in nanoseconds, frame id, x, y, z, qx, qy, qz, qw, fields, bytes per point, points."""


def _from_protobuf(data: bytes | memoryview) -> _Parts:
    try:
        cloud = PointCloud.FromString(data)
    except DecodeError as error:
        raise ValueError("cannot be unpacked: it is not a foxglove.PointCloud, or was cut off") from error
    position, turn = cloud.pose.position, cloud.pose.orientation
    return (
        cloud.timestamp.seconds * 10**9 + cloud.timestamp.nanos,
        cloud.frame_id,
        (position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w),
        tuple(PointField(field.name, field.offset, _DATATYPES.get(field.type, 0)) for field in cloud.fields),
        cloud.point_stride,
        cloud.data,
    )


def _from_json(message: bytes | memoryview) -> _Parts:
    try:
        table, data = _table_and_data(memoryview(message))
        stamp, pose = table.get("timestamp") or {}, table.get("pose") or {}
        fields = tuple(
            PointField(sanitize_text(entry["name"]), int(entry.get("offset", 0)), _DATATYPES.get(entry.get("type"), 0))
            for entry in table["fields"]
        )
        return (
            int(stamp.get("sec", 0)) * 10**9 + int(stamp.get("nsec", 0)),
            sanitize_text(table.get("frame_id", "")),
            _numbers(pose.get("position"), "xyz") + _numbers(pose.get("orientation"), "xyzw"),
            fields,
            int(table["point_stride"]),
            data,
        )
    except KeyError as error:
        raise ValueError(f"cannot be unpacked: its JSON has no key {error}") from error
    except (AttributeError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError("cannot be unpacked: it is not JSON of a foxglove.PointCloud") from error


def _table_and_data(message: memoryview) -> tuple[dict[str, Any], bytes]:
    """Return the JSON object and its decoded ``data``."""
    # Nearly all of the message is this one text, in most files the last key; parsing it as JSON takes most of the time.
    begins, ends = _DATA_KEY.search(message), _DATA_END.search(message[-_TAIL_BYTES:])
    if begins is not None and ends is not None:
        start, end = begins.end(), len(message) - len(ends[0])
        with suppress(ValueError):
            table = json.loads(bytes(message[:start]) + ends[0])
            if table["data"] == "":
                return table, pybase64.b64decode(message[start:end], validate=True)
    table = json.loads(bytes(message))
    return table, pybase64.b64decode(table["data"], validate=True)


def _numbers(table: Mapping[str, Any] | None, names: str) -> list[float]:
    return [float((table or {}).get(name, 0.0)) for name in names]
