# SPDX-License-Identifier: Apache-2.0
"""LAS and LAZ files."""

from __future__ import annotations

import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from multilica.ingest.cloud import Cloud
from multilica.ingest.detect import require_format
from multilica.ingest.recording import Message
from multilica.ingest.unpacking import MAX_UNPACKED_BYTES
from multilica.pointcloud2 import finite_points
from multilica.snapshot import Scan

__all__ = ["decode_cloud"]

_VERSION_MINOR = 25
_TABLE = struct.Struct("<HIIBHI")
_TABLE_AT = 94
_SCALES_AT = 131
_COUNT_1_4_AT = 247
_SMALLEST_HEADER = 227
_HEADER_1_4 = 375
_VLR_HEAD = struct.Struct("<2x16sHH32x")
_LASZIP = (b"laszip encoded", 22204)
_COMPRESSED = 0x80
_SMALLEST_POINT = 20
_ENGINE_BYTES = 512 << 20
_ENGINE_S = 60.0
"""What the process that unpacks may take besides the points."""


@dataclass(frozen=True, slots=True)
class _Header:
    """What is needed of the file's head.

    Args:
        vlrs: range of bytes of the variable length records.
        points_at: first byte of the points.
        scales, offsets: metres per unit, and metres, per axis.
    """

    vlrs: range
    vlrs_count: int
    points_at: int
    point_bytes: int
    count: int
    compressed: bool
    scales: tuple[float, ...]
    offsets: tuple[float, ...]


def decode_cloud(message: Message) -> Cloud:
    """Unpack a LAS file of any version, or a LAZ file.

    The header is read here and not by `laspy`, which believes any size that a header claims.

    Raises:
        ValueError: the file is broken; the text is a predicate.
    """
    data = memoryview(message.data)
    require_format(data, "las")
    header = _header(data)
    records = _decompressed(header, data) if header.compressed else _plain(header, data)
    names, formats = ["x", "y", "z", "intensity"], ["<i4", "<i4", "<i4", "<u2"]
    dtype = np.dtype({"names": names, "formats": formats, "offsets": [0, 4, 8, 12], "itemsize": header.point_bytes})
    points = records.view(dtype)
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (points[axis] * header.scales[index] + header.offsets[index] for index, axis in enumerate("xyz"))
    points_m, intensity = finite_points(x, y, z, points["intensity"])
    return Cloud(Scan(points_m, message.log_time_ns, intensity))


def _header(data: memoryview) -> _Header:
    if len(data) < _SMALLEST_HEADER:
        raise ValueError("ends within its header")
    header_bytes, points_at, vlrs, kind, point_bytes, count = _TABLE.unpack_from(data, _TABLE_AT)
    if data[_VERSION_MINOR] >= 4:
        if len(data) < _HEADER_1_4:
            raise ValueError("ends within its header")
        count = struct.unpack_from("<Q", data, _COUNT_1_4_AT)[0] or count
    if not _SMALLEST_HEADER <= header_bytes <= points_at <= len(data) or point_bytes < _SMALLEST_POINT:
        raise ValueError(f"has a header that contradicts itself: points of {point_bytes} bytes at byte {points_at}")
    numbers = struct.unpack_from("<6d", data, _SCALES_AT)
    held = range(header_bytes, points_at)
    return _Header(held, vlrs, points_at, point_bytes, count, bool(kind & _COMPRESSED), numbers[:3], numbers[3:])


def _plain(header: _Header, data: memoryview) -> npt.NDArray[np.uint8]:
    body = data[header.points_at :]
    if header.count * header.point_bytes > len(body):
        raise ValueError(f"ends after {len(body) // header.point_bytes} of its {header.count} points")
    return np.frombuffer(body, np.uint8, header.count * header.point_bytes)


def _decompressed(header: _Header, data: memoryview) -> npt.NDArray[np.uint8]:
    size = header.count * header.point_bytes
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"claims to unpack to {size} bytes; not more than {MAX_UNPACKED_BYTES} are believed")
    arguments = [header.points_at, size, size + len(data) + _ENGINE_BYTES, _laszip_record(header, data).hex()]
    command = [sys.executable, "-I", str(Path(__file__).with_name("laz_process.py")), *map(str, arguments)]
    try:
        ended = subprocess.run(command, input=data, capture_output=True, timeout=_ENGINE_S, check=False)  # noqa: S603
    except subprocess.TimeoutExpired as error:
        raise ValueError("has compressed points that cannot be unpacked") from error
    if ended.returncode or len(ended.stdout) != size:
        raise ValueError("has compressed points that cannot be unpacked")
    return np.frombuffer(ended.stdout, np.uint8)


def _laszip_record(header: _Header, data: memoryview) -> bytes:
    place = header.vlrs.start
    for _ in range(header.vlrs_count):
        if place + _VLR_HEAD.size > header.vlrs.stop:
            break
        user, number, size = _VLR_HEAD.unpack_from(data, place)
        place += _VLR_HEAD.size
        if (user.rstrip(b"\0"), number) == _LASZIP and place + size <= header.vlrs.stop:
            return bytes(data[place : place + size])
        place += size
    raise ValueError("has compressed points, yet no record that says how")
