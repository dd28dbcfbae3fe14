# SPDX-License-Identifier: Apache-2.0
"""The decoder of PCD files.

`pypcd4` refuses headers that PCL accepts, Open3D turns broken files into empty clouds, and both allocate whatever a
header claims.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import lzf
import numpy as np
import numpy.typing as npt

from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import Cloud
from multilica.ingest.point_files.point_table import MAX_HEADER_BYTES, Points, PointTable, row_count
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import DATATYPES, PointField, finite_points
from multilica.snapshot import Scan

_KINDS = {"F": "f", "I": "i", "U": "u"}
_DATATYPE_OF = {name: datatype for datatype, name in DATATYPES.items()}
_SIZES = struct.Struct("<II")
_READ = ("x", "y", "z", "intensity")
_MAX_FIELDS = 1024
_MAX_COUNT = 1 << 16
_LISTED = 8
_MAX_LZF_RATIO = 88
"""LZF's longest match has 264 bytes, stored in 3."""


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a PCD file with ascii, binary or binary_compressed data."""
    data = memoryview(message.data)
    require_format(data, FORMATS["pcd"])
    table, storage, start = _read_header(bytes(data[:MAX_HEADER_BYTES]))
    points_m, intensity = _read_points(table, storage, data[start:])
    return Cloud(Scan(points_m, message.log_time_ns, intensity))


def claimed_bytes(head: bytes) -> int:
    """Return the size in bytes that the beginning of a file claims; that of the beginning if it is broken."""
    try:
        table, storage, start = _read_header(head)
    except ValueError:
        return len(head)
    if storage == "binary_compressed":
        return start + _SIZES.size + int.from_bytes(head[start : start + 4], "little")
    return start + table.claimed_bytes(is_text=storage == "ascii")


def _read_header(head: bytes) -> tuple[PointTable, str, int]:
    entries: dict[str, list[str]] = {}
    start = 0
    for line in head.splitlines(keepends=True):
        start += len(line)
        words = line.decode("latin1").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        if words and words[0].upper() == "DATA":
            return _table_of(entries), "".join(words[1:2]).lower(), start
    raise ValueError("has no line DATA in its header")


def _table_of(entries: Mapping[str, list[str]]) -> PointTable:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes, kinds = _numbers(entries, "SIZE"), entries.get("TYPE", [])
    counts = _numbers(entries, "COUNT") or [1] * len(names)
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("has header lines FIELDS, SIZE, TYPE and COUNT that are missing or differ in length")
    if (
        len(names) > _MAX_FIELDS
        or max((*sizes, *counts)) > _MAX_COUNT
        or any(count < 1 for name, count in zip(names, counts, strict=True) if name in _READ)
    ):
        raise ValueError(
            f"has the header lines SIZE {_listed(sizes)} and COUNT {_listed(counts)}, which are impossible"
        )
    widths = [size * count for size, count in zip(sizes, counts, strict=True)]
    offsets = [0, *accumulate(widths)]
    types = [f"{_KINDS.get(kind.upper(), '?')}{size}" for kind, size in zip(kinds, sizes, strict=True)]
    fields = tuple(
        PointField(name, offset, _DATATYPE_OF.get(kind, 0), count)
        for name, offset, kind, count in zip(names, offsets, types, counts, strict=False)
    )
    return PointTable(fields, _points(entries), offsets[-1])


def _points(entries: Mapping[str, list[str]]) -> int:
    width, height, points = (_numbers(entries, key)[:1] for key in ("WIDTH", "HEIGHT", "POINTS"))
    if not width:
        if not points:
            raise ValueError("has neither POINTS nor WIDTH in its header")
        return points[0]
    product = math.prod(width + height)
    if points and points[0] != product:
        raise ValueError(f"claims {points[0]} points in its header, but {' x '.join(map(str, width + height))}")
    return product


def _numbers(entries: Mapping[str, list[str]], key: str) -> list[int]:
    words = entries.get(key, [])
    try:
        return [row_count(word) for word in words]
    except ValueError as error:
        raise ValueError(f"has the header line '{key} {_listed(words)}'; expected whole numbers") from error


def _listed(words: Sequence[object]) -> str:
    return " ".join(map(str, words[:_LISTED])) + (" ..." if len(words) > _LISTED else "")


def _read_points(table: PointTable, storage: str, body: memoryview) -> Points:
    if table.rows == 0:
        return finite_points(*np.empty((3, 0), np.float32))
    if storage == "ascii":
        return table.read_text(body)
    if storage == "binary":
        return table.read_records(body)
    if storage == "binary_compressed":
        return _read_compressed(table, body)
    raise ValueError(f"has DATA {storage}; expected ascii, binary or binary_compressed")


def _read_compressed(table: PointTable, body: memoryview) -> Points:
    raw = _decompressed(table.rows, table.rows * table.row_bytes, body)
    first = {field.name: field for field in reversed(table.fields)}
    columns: list[npt.NDArray[Any]] = []
    for field in (first[name] for name in table.needed()):
        dtype = np.dtype(f"<{DATATYPES[field.datatype]}")
        # One field of all points after the other, not point after point.
        start, step = field.offset * table.rows, dtype.itemsize * field.count
        columns.append(np.ndarray((table.rows,), dtype, raw, start, (step,)))
    return finite_points(*columns)


def _decompressed(rows: int, expected: int, body: memoryview) -> bytes:
    if len(body) < _SIZES.size:
        raise ValueError("ends before its compressed data begin")
    compressed, claimed = _SIZES.unpack_from(body)
    packed = bytes(body[_SIZES.size :][:compressed])
    if len(packed) < compressed:
        raise ValueError(f"ends after {len(packed)} of its {compressed} compressed bytes")
    if claimed != expected or expected > _MAX_LZF_RATIO * compressed:
        raise ValueError(f"claims that {compressed} bytes unpack to {claimed}; expected {expected} for {rows} points")
    memory_budget().require(2 * expected)
    try:
        raw = lzf.decompress(packed, expected)
    except ValueError as error:
        raise ValueError("has compressed data that cannot be unpacked") from error
    if raw is None or len(raw) != expected:
        raise ValueError(f"unpacks to {len(raw or b'')} bytes; expected {expected} for {rows} points")
    return bytes(raw)
