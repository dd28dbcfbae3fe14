# SPDX-License-Identifier: Apache-2.0
"""Foxglove's point clouds, in protocol buffers or JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import pybase64

from multilica.ingest.cloud import Cloud
from multilica.ingest.encodable import encodable
from multilica.ingest.protobuf_wire import fields_of, fixed32, float64
from multilica.ingest.recording import Message
from multilica.pointcloud2 import PointCloud2, PointField, decode_points
from multilica.snapshot import Scan

__all__ = ["decode_cloud"]

_DATATYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
"""Foxglove's number types -> those of `PointField`: the unsigned come first there."""
_DATA_KEY = re.compile(rb'"data"\s*:\s*"')
_DATA_END = re.compile(rb'"\s*}\s*\Z')
_TAIL_BYTES = 64
_POSE_TOLERANCE = 1e-9


@dataclass(slots=True)
class _Parts:
    """A ``foxglove.PointCloud``; `pose` holds x, y, z, qx, qy, qz, qw."""

    stamp_ns: int = 0
    frame_id: str = ""
    pose: list[float] = field(default_factory=lambda: [0.0] * 7)
    point_stride: int = 0
    fields: list[PointField] = field(default_factory=list)
    data: bytes | memoryview = b""


def decode_cloud(message: Message) -> Cloud:
    """Unpack a ``foxglove.PointCloud``; points stay in the cloud's own frame, whatever pose it gives itself.

    Raises:
        ValueError: the message is broken; the text is a predicate.
    """
    parts = _from_json(message.data) if message.encoding == "json" else _from_protobuf(memoryview(message.data))
    width, rest = divmod(len(parts.data), parts.point_stride) if parts.point_stride else (0, len(parts.data))
    if rest:
        raise ValueError(f"holds {len(parts.data)} bytes of points of {parts.point_stride} bytes each")
    cloud = PointCloud2(tuple(parts.fields), width, 1, parts.point_stride, len(parts.data), parts.data)
    points_m, intensity = decode_points(cloud)
    stamp_ns = parts.stamp_ns if parts.stamp_ns > 0 else message.log_time_ns
    frame_id = parts.frame_id.strip("/")
    return Cloud(Scan(points_m, stamp_ns, intensity), frame_id, _pose_remark(parts.pose, frame_id))


def _from_protobuf(data: memoryview) -> _Parts:
    parts = _Parts()
    for number, value in fields_of(data):
        if number == 4:
            parts.point_stride = fixed32(value)
        elif isinstance(value, int):
            continue
        elif number == 1:
            time = {key: part for key, part in fields_of(value) if isinstance(part, int)}
            parts.stamp_ns = time.get(1, 0) * 10**9 + time.get(2, 0)
        elif number == 2:
            parts.frame_id = str(value, "utf-8")
        elif number == 3:
            parts.pose = _pose_of(value)
        elif number == 5:
            parts.fields.append(_field_of(value))
        elif number == 6:
            parts.data = value
    return parts


def _pose_of(message: memoryview) -> list[float]:
    pose = [0.0] * 7
    for part, value in fields_of(message):
        if part in (1, 2) and not isinstance(value, int):
            for axis, number in fields_of(value):
                if 1 <= axis <= part + 2:
                    pose[3 * (part - 1) + axis - 1] = float64(number)
    return pose


def _field_of(message: memoryview) -> PointField:
    name, offset, kind = "", 0, 0
    for number, value in fields_of(message):
        if number == 1 and not isinstance(value, int):
            name = str(value, "utf-8")
        elif number == 2:
            offset = fixed32(value)
        elif number == 3 and isinstance(value, int):
            kind = value
    return PointField(name, offset, _DATATYPES.get(kind, 0))


def _from_json(message: bytes | memoryview) -> _Parts:
    try:
        table, data = _table_and_data(memoryview(message))
        stamp, pose = table.get("timestamp") or {}, table.get("pose") or {}
        return _Parts(
            int(stamp.get("sec", 0)) * 10**9 + int(stamp.get("nsec", 0)),
            encodable(table.get("frame_id", "")),
            _numbers(pose.get("position"), "xyz") + _numbers(pose.get("orientation"), "xyzw"),
            int(table["point_stride"]),
            [
                PointField(encodable(entry["name"]), int(entry.get("offset", 0)), _DATATYPES.get(entry.get("type"), 0))
                for entry in table["fields"]
            ],
            data,
        )
    except KeyError as error:
        raise ValueError(f"cannot be unpacked: its JSON has no key {error}") from error
    except (AttributeError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError("cannot be unpacked: it is no JSON of a foxglove.PointCloud") from error


def _table_and_data(message: memoryview) -> tuple[dict[str, Any], bytes]:
    """The JSON object, and what its ``data`` decode to."""
    # Nearly all of the message is this one text, last as in the schema; to parse it as JSON takes most of the time.
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


def _pose_remark(pose: list[float], frame_id: str) -> str:
    """Says so if the cloud's origin is not that of its frame."""
    x, y, z, qx, qy, qz, qw = pose
    turned = max(abs(qx), abs(qy), abs(qz)) > _POSE_TOLERANCE * max(1.0, abs(qw))
    if math.hypot(x, y, z) <= _POSE_TOLERANCE and not turned:
        return ""
    return f"gives its clouds a pose of their own in '{frame_id}'; the result is for the cloud's origin, not that frame"
