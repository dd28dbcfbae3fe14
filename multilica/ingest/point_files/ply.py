# SPDX-License-Identifier: Apache-2.0
"""The decoder of PLY files.

Open3D turns broken files into empty clouds and drops the intensity; `plyfile` is under the GPL.
"""

from dataclasses import dataclass, replace

import numpy as np

from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.message_types import Cloud
from multilica.ingest.point_files.point_table import MAX_HEADER_BYTES, PointTable, row_count
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import DATATYPES, PointField, finite_points
from multilica.snapshot import Scan

_STORAGES = ("ascii", "binary_little_endian", "binary_big_endian")
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_DATATYPE_OF = {name: datatype for datatype, name in DATATYPES.items()}
_ALIASES = {"scalar_Intensity": "intensity", "scalar_intensity": "intensity", "Intensity": "intensity"}


@dataclass(frozen=True, slots=True)
class _Element(PointTable):
    name: str = ""
    has_list: bool = False


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode the vertices of a PLY file with ascii or binary data."""
    data = memoryview(message.data)
    require_format(data, FORMATS["ply"])
    storage, elements, start = _read_header(bytes(data[:MAX_HEADER_BYTES]))
    before, vertices = _find_vertices(elements)
    if vertices.rows == 0:
        points_m, intensity = finite_points(*np.empty((3, 0), np.float32))
    elif storage == "ascii":
        points_m, intensity = vertices.read_text(data[start:], sum(element.rows for element in before))
    else:
        skipped = sum(element.rows * element.row_bytes for element in before)
        points_m, intensity = vertices.read_records(data[start + skipped :], big_endian=storage.endswith("big_endian"))
    return Cloud(Scan(points_m, message.log_time_ns, intensity))


def claimed_bytes(head: bytes) -> int:
    """Return the size in bytes up to the end of the vertices, as the beginning of a file claims it."""
    try:
        storage, elements, start = _read_header(head)
        before, vertices = _find_vertices(elements)
    except ValueError:
        return len(head)
    return start + sum(element.claimed_bytes(is_text=storage == "ascii") for element in (*before, vertices))


def _read_header(head: bytes) -> tuple[str, list[_Element], int]:
    storage, start = "", 0
    elements: list[_Element] = []
    for line in head.splitlines(keepends=True):
        start += len(line)
        match line.decode("latin1").split():
            case ["format", name, *_]:
                storage = name
            case ["element", name, rows]:
                elements.append(_Element(rows=_whole_number(rows), name=name))
            case ["property", *words] if elements:
                elements[-1] = _with_property(elements[-1], words)
            case ["end_header"]:
                if storage not in _STORAGES:
                    raise ValueError(f"has format '{storage}'; expected {', '.join(_STORAGES)}")
                return storage, elements, start
    raise ValueError("has no line end_header")


def _whole_number(word: str) -> int:
    try:
        return row_count(word)
    except ValueError as error:
        raise ValueError(f"has '{word[:20]}' in its header where the number of rows is expected") from error


def _with_property(element: _Element, words: list[str]) -> _Element:
    match words:
        case ["list", _, _, _]:
            return replace(element, has_list=True)
        case [kind, name] if kind in _TYPES:
            dtype = np.dtype(_TYPES[kind])
            field = PointField(_ALIASES.get(name, name), element.row_bytes, _DATATYPE_OF[_TYPES[kind]])
            return replace(element, fields=(*element.fields, field), row_bytes=element.row_bytes + dtype.itemsize)
        case _:
            raise ValueError(f"has the unknown property '{' '.join(words)}' in its header")


def _find_vertices(elements: list[_Element]) -> tuple[list[_Element], _Element]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError(f"has no element vertex; its elements are: {', '.join(names) or 'none'}")
    index = names.index("vertex")
    if any(element.has_list for element in elements[: index + 1]):
        raise ValueError("has lists among its vertices or before them, which cannot be read")
    return elements[:index], elements[index]
