# SPDX-License-Identifier: Apache-2.0
"""The decoder of array files: KITTI's ``.bin``, nuScenes' ``.pcd.bin``, NumPy's ``.npy``."""

import math
import tokenize
from io import BytesIO
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from multilica.documents import shown
from multilica.ingest.formats import FORMATS, require_format
from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import RING_NAMES, finite_points

Table: TypeAlias = npt.NDArray[Any]

_COLUMNS = {"kitti": 4, "nuscenes": 5}
_NAMES = ("x", "y", "z", "intensity", "ring")
_LAYOUTS = (3, 4, 5, 6)
_LEAST_ROWS = 200
_CLOSER = 0.2
_MAX_SIZE = 1 << 40
_NEAREST_M, _FARTHEST_M = 1e-6, 1e4
_PLAUSIBLE_SHARE = 0.9
"""Share of numbers in this range among coordinates; of random bytes, seven in eight are outside."""


_MOST_COLUMNS = 64
"""Columns of a row per point; more are points of a table that was not transposed."""


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode rows of x, y, z in metres and, if there are any, intensity and ring."""
    data = memoryview(message.data)
    require_format(data, FORMATS[message.encoding])
    table = _npy(data) if message.encoding == "npy" else _rows(data, _COLUMNS[message.encoding])
    columns = _columns(table, _COLUMNS.get(message.encoding, 4))
    return Cloud(finite_points(**columns).as_scan(message.log_time_ns))


def _rows(data: memoryview, columns: int) -> Table:
    row_bytes = 4 * columns
    _require_layout(data, columns)
    if len(data) % row_bytes:
        raise ValueError(f"has {len(data)} bytes; expected a multiple of {row_bytes}: {columns} float32 per point")
    table = np.frombuffer(data, "<f4").reshape(-1, columns)
    size_m = np.abs(table[:, :3])
    plausible = (size_m < _FARTHEST_M) & ((size_m > _NEAREST_M) | (size_m == 0.0)) | np.isnan(size_m)
    if np.count_nonzero(plausible) < _PLAUSIBLE_SHARE * plausible.size:
        raise ValueError(f"has no coordinates: expected x, y, z in metres among {columns} float32 per point")
    return table


def _require_layout(data: memoryview, columns: int) -> None:
    """Raise ValueError if points in another number of columns are far closer to the next ones.

    Neighbours in a file are mostly neighbours in the scene, unless numbers are taken for coordinates that are none.
    """
    numbers = np.frombuffer(data, "<f4", len(data) // 4)
    steps_m: dict[int, float] = {}
    for count in _LAYOUTS:
        xyz_m = numbers[: len(numbers) // count * count].reshape(-1, count)[:, :3]
        if len(xyz_m) >= _LEAST_ROWS and (count == columns or len(numbers) % count == 0):
            with np.errstate(all="ignore"):
                step_m = float(np.nanmedian(np.abs(np.diff(xyz_m, axis=0)).max(axis=1)))
            steps_m[count] = step_m if np.isfinite(step_m) else np.inf
    likely = min(steps_m, key=lambda count: (steps_m[count], count), default=columns)
    if likely != columns and steps_m[likely] < _CLOSER * steps_m.get(columns, 0.0):
        raise ValueError(
            f"holds points of {likely} float32; expected {columns} with x, y, z first: save it as PCD or .npy"
        )


def _npy(data: memoryview) -> Table:
    head = BytesIO(data)
    try:
        version = np.lib.format.read_magic(head)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran_order, dtype = read(head)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError, tokenize.TokenError) as error:
        raise ValueError("has an invalid NumPy header") from error
    if not all(type(size) is int and 0 <= size < _MAX_SIZE for size in shape):
        raise ValueError(f"claims the impossible shape {shown(shape)}")
    count = math.prod(shape)
    if dtype.hasobject or not dtype.itemsize:
        raise ValueError(f"holds {dtype}; expected numbers")
    if count * dtype.itemsize > len(data) - head.tell():
        raise ValueError(f"claims {' x '.join(map(str, shape))} values of {dtype}, but ends before")
    flat = np.frombuffer(data, dtype, count, head.tell())
    return flat.reshape(shape, order="F" if fortran_order else "C")


def _columns(table: Table, count: int) -> dict[str, Table]:
    """Return x, y, z and perhaps intensity and ring (N,), by name, or by position up to `count`."""
    if table.dtype.names is None:
        if table.ndim != 2 or table.shape[1] < 3 or table.dtype.kind not in "fiu":
            found = f"{' x '.join(map(str, table.shape)) or 'a single'} values of {table.dtype}"
            raise ValueError(f"holds {found}; expected N x 3 numbers or more")
        if table.shape[0] <= 4 and table.shape[1] > _MOST_COLUMNS:
            raise ValueError(
                f"holds {table.shape[0]} x {table.shape[1]} numbers; expected a row per point: transpose it"
            )
        return dict(zip(_NAMES, table.T[:count], strict=False))
    given = [name for name in table.dtype.names if name != "ring" or table.dtype[name].kind in "fiu"]
    ring = next((name for name in RING_NAMES if name in given and table.dtype[name].kind in "fiu"), "ring")
    sources = dict(zip(_NAMES, (*_NAMES[:-1], ring), strict=True))
    named = [name for name, source in sources.items() if source in given]
    kinds = {table.dtype[sources[name]].kind for name in named}
    if named[:3] != ["x", "y", "z"] or table.ndim != 1 or not kinds <= set("fiu"):
        raise ValueError(f"holds the fields {', '.join(table.dtype.names)}; expected numbers x, y, z")
    return {name: table[sources[name]] for name in named}
