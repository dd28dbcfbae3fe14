# SPDX-License-Identifier: Apache-2.0
"""The decoder of PCD files.

`pypcd4` refuses headers that PCL accepts, Open3D turns broken files into empty clouds, and both allocate whatever a
header claims.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import lzf
import numpy as np
import numpy.typing as npt

from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.messages.cloud import Cloud
from multilica.ingest.point_files.ascii_table import read_columns
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import DATATYPES, PointCloud2, PointField, decode_points, finite_points, point_dtype
from multilica.snapshot import Float32Array, Scan

__all__ = ["decode_cloud"]

_MAX_HEADER_BYTES = 1 << 16
_KINDS = {"F": "f", "I": "i", "U": "u"}
_DATATYPE_OF = {name: datatype for datatype, name in DATATYPES.items()}
_SIZES = struct.Struct("<II")
_MAX_LZF_RATIO = 88
"""LZF's longest match has 264 bytes, stored in 3."""


@dataclass(frozen=True, slots=True)
class _PcdHeader:
    fields: tuple[PointField, ...]
    columns: Mapping[str, int]
    point_step: int
    points: int
    storage: str


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a PCD file with ascii, binary or binary_compressed data.

    Raises:
        ValueError: the file is broken; the text is a predicate.
    """
    data = memoryview(message.data)
    require_format(data, FORMATS["pcd"])
    header, start = _read_header(bytes(data[:_MAX_HEADER_BYTES]))
    points_m, intensity = _read_points(header, data[start:])
    return Cloud(Scan(points_m, message.log_time_ns, intensity))


def _read_header(head: bytes) -> tuple[_PcdHeader, int]:
    table: dict[str, list[str]] = {}
    start = 0
    for line in head.splitlines(keepends=True):
        start += len(line)
        words = line.decode("latin1").split()
        if words and not words[0].startswith("#"):
            table[words[0].upper()] = words[1:]
        if words and words[0].upper() == "DATA":
            return _header_of(table), start
    raise ValueError("has no line DATA in its header")


def _header_of(table: Mapping[str, list[str]]) -> _PcdHeader:
    names = table.get("FIELDS", table.get("COLUMNS", []))
    sizes, kinds = _numbers(table, "SIZE"), table.get("TYPE", [])
    counts = _numbers(table, "COUNT") or [1] * len(names)
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("has header lines FIELDS, SIZE, TYPE and COUNT that are missing or differ in length")
    widths = [size * count for size, count in zip(sizes, counts, strict=True)]
    offsets = [0, *accumulate(widths)]
    types = [f"{_KINDS.get(kind.upper(), '?')}{size}" for kind, size in zip(kinds, sizes, strict=True)]
    fields = tuple(
        PointField(name, offset, _DATATYPE_OF.get(kind, 0), count)
        for name, offset, kind, count in zip(names, offsets, types, counts, strict=False)
    )
    columns = dict(zip(reversed(names), reversed([0, *accumulate(counts)][:-1]), strict=True))
    return _PcdHeader(fields, columns, offsets[-1], _points(table), "".join(table["DATA"][:1]).lower())


def _points(table: Mapping[str, list[str]]) -> int:
    width, height, points = (_numbers(table, key)[:1] for key in ("WIDTH", "HEIGHT", "POINTS"))
    if not width:
        if not points:
            raise ValueError("has neither POINTS nor WIDTH in its header")
        return points[0]
    product = math.prod(width + height)
    if points and points[0] != product:
        raise ValueError(f"claims {points[0]} points in its header, but {' x '.join(map(str, width + height))}")
    return product


def _numbers(table: Mapping[str, list[str]], key: str) -> list[int]:
    words = table.get(key, [])
    if not all(word.isascii() and word.isdigit() for word in words):
        raise ValueError(f"has the header line '{key} {' '.join(words)}'; expected whole numbers")
    return [int(word) for word in words]


def _read_points(header: _PcdHeader, body: memoryview) -> tuple[Float32Array, Float32Array | None]:
    if header.points == 0:
        return finite_points(*np.empty((3, 0), np.float32))
    if header.storage == "ascii":
        return _read_ascii(header, bytes(body))
    if header.storage == "binary":
        return _read_binary(header, body)
    if header.storage == "binary_compressed":
        return _read_compressed(header, body)
    raise ValueError(f"has DATA {header.storage}; expected ascii, binary or binary_compressed")


def _read_ascii(header: _PcdHeader, body: bytes) -> tuple[Float32Array, Float32Array | None]:
    names = [field.name for field in _needed(header)]
    return finite_points(*read_columns(body, [header.columns[name] for name in names], header.points))


def _read_binary(header: _PcdHeader, body: memoryview) -> tuple[Float32Array, Float32Array | None]:
    if header.points * header.point_step > len(body):
        whole = len(body) // header.point_step
        raise ValueError(f"ends after {whole} of its {header.points} points")
    return decode_points(PointCloud2(header.fields, header.points, 1, header.point_step, 0, body))


def _read_compressed(header: _PcdHeader, body: memoryview) -> tuple[Float32Array, Float32Array | None]:
    raw = _decompressed(header, body)
    columns: list[npt.NDArray[Any]] = []
    for field in _needed(header):
        dtype = np.dtype(f"<{DATATYPES[field.datatype]}")
        # One field of all points after the other, not point after point.
        start, step = field.offset * header.points, dtype.itemsize * field.count
        columns.append(np.ndarray((header.points,), dtype, raw, start, (step,)))
    return finite_points(*columns)


def _needed(header: _PcdHeader) -> list[PointField]:
    names = point_dtype(header.fields, header.point_step, big_endian=False).names or ()
    first = {field.name: field for field in reversed(header.fields)}
    return [first[name] for name in names]


def _decompressed(header: _PcdHeader, body: memoryview) -> bytes:
    expected = header.points * header.point_step
    if len(body) < _SIZES.size:
        raise ValueError("ends before its compressed data begin")
    compressed, claimed = _SIZES.unpack_from(body)
    packed = bytes(body[_SIZES.size :][:compressed])
    if len(packed) < compressed:
        raise ValueError(f"ends after {len(packed)} of its {compressed} compressed bytes")
    if claimed != expected or expected > _MAX_LZF_RATIO * compressed:
        raise ValueError(
            f"claims that {compressed} bytes unpack to {claimed}; expected {expected} for {header.points} points"
        )
    try:
        raw = lzf.decompress(packed, expected)
    except ValueError as error:
        raise ValueError("has compressed data that cannot be unpacked") from error
    if raw is None or len(raw) != expected:
        raise ValueError(f"unpacks to {len(raw or b'')} bytes; expected {expected} for {header.points} points")
    return bytes(raw)
