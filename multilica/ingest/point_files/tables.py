# SPDX-License-Identifier: Apache-2.0
"""The decoder of PCD and PLY files: a header that describes a table of points, which follows as text or records.

`pypcd4` refuses headers that PCL accepts; Open3D turns broken files into empty clouds and drops the intensity of PLY
files; both allocate whatever a header claims. `plyfile` is under the GPL.
"""

import math
import re
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import accumulate, islice
from typing import Any

import lzf
import numpy as np
import numpy.typing as npt

from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import (
    DATATYPES,
    PointCloud2,
    PointField,
    Points,
    decode_points,
    finite_points,
    point_dtype,
    read_fields,
)

MAX_HEADER_BYTES = 1 << 16
_MAX_LINE_BYTES = 1 << 16
_MAX_FIELDS = 1024
_MAX_COUNT = 1 << 16
_LISTED = 8
_NO_VIEWPOINT = r"(-?0(\.0*)? ){3}1(\.0*)?( -?0(\.0*)?){3}"
_MAX_LZF_RATIO = 88
"""LZF's longest match has 264 bytes, stored in 3."""
_SIZES = struct.Struct("<II")
_DATATYPE_OF = {name: datatype for datatype, name in DATATYPES.items()}

_STORAGES = {"ascii": "ascii", "binary_little_endian": "binary", "binary_big_endian": "big endian"}
"""Storage in a PLY file -> that of `PointTable`."""
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ALIASES = {
    "scalar_Intensity": "intensity", "scalar_intensity": "intensity", "Intensity": "intensity",
    "scalar_Ring": "ring", "scalar_ring": "ring",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class PointTable:
    """The layout of a table.

    Its methods raise ValueError, with a predicate as its text, if the data are broken.

    Args:
        fields: in the order of the columns.
        storage: ``"ascii"``, ``"binary"`` (little endian), ``"big endian"`` or ``"binary_compressed"``.
        start: bytes of the header.
        skipped: rows before the table, and their bytes if they are not text.
        remark: as of `Cloud`.
    """

    fields: tuple[PointField, ...] = ()
    rows: int = 0
    row_bytes: int = 0
    storage: str = "binary"
    start: int = 0
    skipped: tuple[int, int] = (0, 0)
    remark: str = ""

    def claimed_bytes(self, head: bytes) -> int:
        """Return the largest size in bytes of a file that begins with `head`, up to the end of the table."""
        if self.storage == "binary_compressed":
            return self.start + _SIZES.size + int.from_bytes(head[self.start : self.start + 4], "little")
        if self.storage == "ascii":
            return self.start + (self.skipped[0] + self.rows) * _MAX_LINE_BYTES
        return self.start + self.skipped[1] + self.rows * self.row_bytes

    def read(self, data: memoryview) -> Points:
        """Read the table of a file."""
        if self.rows == 0:
            return finite_points(*np.empty((3, 0), np.float32))
        match self.storage:
            case "ascii":
                return self._read_text(data[self.start :])
            case "binary" | "big endian":
                return self.read_records(data[self.start + self.skipped[1] :])
            case "binary_compressed":
                return self._read_compressed(data[self.start :])
        raise ValueError(f"has DATA {self.storage}; expected ascii, binary or binary_compressed")

    def read_records(self, body: memoryview) -> Points:
        """Read rows of `row_bytes` each."""
        if self.rows * self.row_bytes > len(body):
            raise ValueError(f"ends after {len(body) // self.row_bytes} of its {self.rows} points")
        return decode_points(
            PointCloud2(self.fields, self.rows, 1, self.row_bytes, 0, body, self.storage == "big endian")
        )

    def _read_text(self, body: memoryview) -> Points:
        """Read lines of numbers; empty ones do not count."""
        ends = accumulate(field.count for field in self.fields)
        columns = {field: end - field.count for field, end in zip(self.fields, ends, strict=True)}
        chosen = self._chosen()
        wanted = [columns[field] for field in chosen.values()]
        lines = islice(_filled_lines(body), self.skipped[0], self.skipped[0] + self.rows)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="loadtxt: input contained no data")
                table = np.loadtxt(lines, np.float64, comments=None, usecols=wanted, ndmin=2, encoding="latin1")
        except ValueError as error:
            reason = str(error).partition(";")[0].rstrip(".")[:200]
            raise ValueError(f"has text that is not a table of points: {reason}") from error
        if len(table) < self.rows:
            raise ValueError(f"ends after {len(table)} of its {self.rows} points")
        return finite_points(**dict(zip(chosen, table.T, strict=True)))

    def _read_compressed(self, body: memoryview) -> Points:
        raw = _decompressed(self.rows, self.rows * self.row_bytes, body)
        columns: dict[str, npt.NDArray[Any]] = {}
        for name, field in self._chosen().items():
            dtype = np.dtype(f"<{DATATYPES[field.datatype]}")
            # One field of all points after the other, not point after point.
            start, step = field.offset * self.rows, dtype.itemsize * field.count
            columns[name] = np.ndarray((self.rows,), dtype, raw, start, (step,))
        return finite_points(**columns)

    def _chosen(self) -> dict[str, PointField]:
        point_dtype(self.fields, self.row_bytes, big_endian=False)
        return read_fields(self.fields, self.row_bytes)


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a PCD file with ascii, binary or binary_compressed data, or the vertices of a PLY file."""
    data = memoryview(message.data)
    require_format(data, FORMATS[message.encoding])
    table = _HEADERS[message.encoding](bytes(data[:MAX_HEADER_BYTES]))
    return Cloud(table.read(data).as_scan(message.log_time_ns), remark=table.remark)


def claimed_bytes(encoding: str, head: bytes) -> int | None:
    """Return the size in bytes that the beginning of a file claims; its own if it is broken, None if it cannot tell."""
    if encoding not in _HEADERS:
        return None
    try:
        return _HEADERS[encoding](head).claimed_bytes(head)
    except ValueError:
        return len(head)


def _whole_number(word: str) -> int | None:
    return int(word) if word.isascii() and word.isdigit() and len(word) <= 18 else None


def _filled_lines(body: memoryview) -> Iterator[bytes]:
    """Yield the lines that are not empty; they may end as on an old Mac."""
    has_lines = b"\n" in bytes(body[:_MAX_LINE_BYTES])
    text = BytesIO(body if has_lines else bytes(body).replace(b"\r", b"\n"))
    while line := text.readline(_MAX_LINE_BYTES):
        if len(line) == _MAX_LINE_BYTES:
            raise ValueError(f"a line has more than {_MAX_LINE_BYTES} bytes")
        if line.strip():
            yield line


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


def _lines(head: bytes) -> Iterator[tuple[list[str], int]]:
    """Yield the words of each line of a header, and the bytes up to its end."""
    end = 0
    for line in head.splitlines(keepends=True):
        end += len(line)
        yield line.decode("latin1").split(), end


def _pcd_header(head: bytes) -> PointTable:
    entries: dict[str, list[str]] = {}
    for words, end in _lines(head):
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        if words and words[0].upper() == "DATA":
            return replace(_pcd_table(entries), storage="".join(words[1:2]).lower(), start=end)
    raise ValueError("has no line DATA in its header")


def _pcd_table(entries: Mapping[str, list[str]]) -> PointTable:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes, kinds = _numbers(entries, "SIZE"), entries.get("TYPE", [])
    counts = _numbers(entries, "COUNT") or [1] * len(names)
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("has header lines FIELDS, SIZE, TYPE and COUNT that are missing or differ in length")
    needed = ("x", "y", "z", "intensity")
    if (
        len(names) > _MAX_FIELDS
        or max((*sizes, *counts)) > _MAX_COUNT
        or any(count < 1 for name, count in zip(names, counts, strict=True) if name in needed)
    ):
        raise ValueError(
            f"has the header lines SIZE {_listed(sizes)} and COUNT {_listed(counts)}, which are impossible"
        )
    offsets = [0, *accumulate(size * count for size, count in zip(sizes, counts, strict=True))]
    fields = tuple(
        PointField(name, offset, _DATATYPE_OF.get(f"{kind.lower()}{size}", 0), count)
        for name, offset, kind, size, count in zip(names, offsets, kinds, sizes, counts, strict=False)
        if count
    )
    viewpoint = " ".join(entries.get("VIEWPOINT", []))
    is_moved = bool(viewpoint) and re.fullmatch(_NO_VIEWPOINT, viewpoint) is None
    remark = "has a VIEWPOINT in its header; its points are used as they are, and the result is for their own origin"
    return PointTable(fields, _points(entries), offsets[-1], remark=remark if is_moved else "")


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
    numbers = [number for word in words if (number := _whole_number(word)) is not None]
    if len(numbers) < len(words):
        raise ValueError(f"has the header line '{key} {_listed(words)}'; expected whole numbers")
    return numbers


def _listed(words: Sequence[object]) -> str:
    return " ".join(map(str, words[:_LISTED])) + (" ..." if len(words) > _LISTED else "")


@dataclass(slots=True)
class _Element:
    """A table of a PLY file so far."""

    name: str
    rows: int
    row_bytes: int = 0
    fields: tuple[PointField, ...] = ()
    has_list: bool = False

    def add(self, words: list[str]) -> None:
        """Add a property."""
        match words:
            case ["list", _, _, _]:
                self.has_list = True
            case [kind, name] if kind in _TYPES:
                field = PointField(_ALIASES.get(name, name), self.row_bytes, _DATATYPE_OF[_TYPES[kind]])
                self.fields, self.row_bytes = (*self.fields, field), self.row_bytes + int(_TYPES[kind][1])
            case _:
                raise ValueError(f"has the unknown property '{' '.join(words)}' in its header")


def _ply_header(head: bytes) -> PointTable:
    storage = ""
    elements: list[_Element] = []
    for words, end in _lines(head):
        match words:
            case ["format", name, *_]:
                storage = name
            case ["element", name, word]:
                if (rows := _whole_number(word)) is None:
                    raise ValueError(f"has '{word[:20]}' in its header where the number of rows is expected")
                elements.append(_Element(name, rows))
            case ["property", *kind] if elements:
                elements[-1].add(kind)
            case ["end_header"]:
                if storage not in _STORAGES:
                    raise ValueError(f"has format '{storage}'; expected {', '.join(_STORAGES)}")
                return replace(_ply_vertices(elements), storage=_STORAGES[storage], start=end)
    raise ValueError("has no line end_header")


def _ply_vertices(elements: list[_Element]) -> PointTable:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError(f"has no element vertex; its elements are: {', '.join(names) or 'none'}")
    *before, vertices = elements[: names.index("vertex") + 1]
    if any(element.has_list for element in (*before, vertices)):
        raise ValueError("has lists among its vertices or before them, which cannot be read")
    skipped = sum(each.rows for each in before), sum(each.rows * each.row_bytes for each in before)
    return PointTable(vertices.fields, vertices.rows, vertices.row_bytes, skipped=skipped)


_HEADERS = {"pcd": _pcd_header, "ply": _ply_header}
"""Format -> reader of the beginning of a file."""
