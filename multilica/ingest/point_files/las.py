# SPDX-License-Identifier: Apache-2.0
"""The decoder of LAS and LAZ files, with `laspy`.

`laspy` believes the number of records in a corrupt header, which is checked first. `lazrs` believes the sizes in LAZ
data and ends its process when one of them is wrong, so it runs in a process of its own.
"""

import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from multilica.ingest.decompression import MAX_UNPACKED_BYTES
from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage, reason_of
from multilica.optional_libraries import needed_for, require_library
from multilica.pointcloud2 import finite_points

with needed_for("Reading LAS and LAZ files", "laspy"):
    import laspy

_POINTS_AND_RECORDS = struct.Struct("<II")
_POINTS_AT = 96
_RECORD_BYTES = 54
_ENGINE_BYTES = 512 << 20
"""Memory of the process that unpacks, besides the points."""


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a LAS file of any version, or a LAZ file."""
    data = memoryview(message.data)
    require_format(data, FORMATS["las"])
    header = _header(data)
    layout, count, start = header.point_format, header.point_count, header.offset_to_point_data
    if header.are_points_compressed:
        data, start = _decompressed(header, data), 0
    elif count * layout.size > len(data) - start:
        raise ValueError(f"ends after {(len(data) - start) // layout.size} of its {count} points")
    points = laspy.PackedPointRecord.from_buffer(data, layout, count, start)
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (points[axis] * header.scales[index] + header.offsets[index] for index, axis in enumerate("XYZ"))
    return Cloud(finite_points(x, y, z, points["intensity"]).as_scan(message.log_time_ns))


def _header(data: memoryview) -> Any:  # noqa: ANN401 - laspy has no types
    if len(data) < _POINTS_AT + _POINTS_AND_RECORDS.size:
        raise ValueError("ends within its header")
    points_at, records = _POINTS_AND_RECORDS.unpack_from(data, _POINTS_AT)
    if not records * _RECORD_BYTES < points_at <= len(data):
        raise ValueError(f"has a corrupt header: {records} records before the points at byte {points_at}")
    try:
        return laspy.LasHeader.read_from(BytesIO(data[:points_at]))
    except Exception as error:
        raise ValueError(f"has a corrupt header: {reason_of(error)}") from error


def _decompressed(header: Any, data: memoryview) -> memoryview:  # noqa: ANN401 - see _header
    size = header.point_count * header.point_format.size
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"claims to unpack to {size} bytes; the limit is {MAX_UNPACKED_BYTES}")
    memory_budget().require(2 * size)
    records = header.vlrs.get("LasZipVlr")
    if not records:
        raise ValueError("has compressed points, but no record that says how to unpack them")
    require_library("Reading LAZ files", "lazrs")
    memory_bytes = size + len(data) + _ENGINE_BYTES
    arguments = [header.offset_to_point_data, size, memory_bytes, records[0].record_data.hex()]
    command = [sys.executable, "-I", str(Path(__file__).with_name("laz_process.py")), *map(str, arguments)]
    try:
        ended = subprocess.run(command, input=data, capture_output=True, timeout=60.0, check=False)  # noqa: S603
    except subprocess.TimeoutExpired as error:
        raise ValueError("has compressed points that cannot be unpacked") from error
    if ended.returncode or len(ended.stdout) != size:
        raise ValueError("has compressed points that cannot be unpacked")
    return memoryview(ended.stdout)
