# SPDX-License-Identifier: Apache-2.0
"""The data layout of `sensor_msgs/PointCloud2`."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.geometry import Float32Array

DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""`PointField.datatype` -> NumPy type without its byte order."""

LIDAR_NAME_KEY = "multilica:lidar"
"""Key of the LiDAR's name in the metadata of an MCAP channel of point clouds."""
SNAPSHOT_METADATA_NAME = "multilica:snapshot"
"""The metadata record of an MCAP file of a snapshot; `frames` is the requested number per LiDAR."""

Column = npt.NDArray[Any]

_COORDINATES = ("x", "y", "z")
_INTENSITY = "intensity"
_FLOAT32 = 7


@dataclass(frozen=True, slots=True)
class PointField:
    """One named value of each point.

    Args:
        offset: bytes from the start of the point.
        datatype: key of `DATATYPES`.
        count: elements; only the first is ever read here.
    """

    name: str
    offset: int
    datatype: int
    count: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud2:
    """Layout of the points in a message.

    Args:
        point_step: bytes from one point to the next.
        row_step: bytes from one row to the next; of no meaning with a single row.
    """

    fields: tuple[PointField, ...]
    width: int
    height: int
    point_step: int
    row_step: int
    data: bytes | memoryview | npt.NDArray[np.uint8]
    big_endian: bool = False


def decode_points(cloud: PointCloud2) -> tuple[Float32Array, Float32Array | None]:
    """Return finite points (N, 3) in the order of the data, with their intensities (N,) or None.

    Raises:
        ValueError: the message contradicts itself; the text is a predicate, such as "has no field z".
    """
    if cloud.width * cloud.height == 0:
        return np.empty((0, 3), np.float32), None
    row_step = _checked_row_step(cloud)
    dtype = point_dtype(cloud.fields, cloud.point_step, big_endian=cloud.big_endian)
    shape, strides = (cloud.height, cloud.width), (row_step, cloud.point_step)
    return finite_records(np.ndarray(shape, dtype, cloud.data, 0, strides))


@lru_cache(maxsize=64)
def point_dtype(fields: tuple[PointField, ...], point_step: int, *, big_endian: bool) -> np.dtype[np.void]:
    """Return the structured type with x, y, z and intensity, if there is one; all other fields are padding.

    Raises:
        ValueError: a coordinate is missing, of unknown type, or outside the point.
    """
    chosen = {field.name: field for field in reversed(fields) if field.name in (*_COORDINATES, _INTENSITY)}
    missing = [name for name in _COORDINATES if name not in chosen]
    if missing:
        listed = ", ".join(field.name for field in fields) or "none"
        raise ValueError(f"has no field {' or '.join(missing)}; its fields are: {listed}")
    names = [name for name in (*_COORDINATES, _INTENSITY) if name in chosen]
    if len({chosen[name].offset for name in _COORDINATES}) < len(_COORDINATES):
        raise ValueError("has two coordinates at the same bytes of each point")
    return np.dtype(
        {
            "names": names,
            "formats": [_format(chosen[name], point_step, big_endian=big_endian) for name in names],
            "offsets": [chosen[name].offset for name in names],
            "itemsize": point_step,
        }
    )


def _format(field: PointField, point_step: int, *, big_endian: bool) -> np.dtype[Any]:
    if field.datatype not in DATATYPES:
        raise ValueError(f"has field {field.name} of the unknown datatype {field.datatype}; expected 1 to 8")
    dtype = np.dtype((">" if big_endian else "<") + DATATYPES[field.datatype])
    if field.offset + dtype.itemsize > point_step:
        raise ValueError(f"has field {field.name} at byte {field.offset} of points of {point_step} bytes")
    return dtype


def _checked_row_step(cloud: PointCloud2) -> int:
    row_bytes = cloud.width * cloud.point_step
    row_step = cloud.row_step if cloud.height > 1 and cloud.row_step else row_bytes
    if row_step < row_bytes:
        raise ValueError(
            f"has rows of {cloud.width} points of {cloud.point_step} bytes, yet a row step of {row_step} bytes"
        )
    needed, found = (cloud.height - 1) * row_step + row_bytes, len(cloud.data)
    if needed > found:
        raise ValueError(
            f"claims {cloud.width} x {cloud.height} points of {cloud.point_step} bytes, which takes {needed} bytes, "
            f"but has {found}"
        )
    return row_step


def finite_records(records: npt.NDArray[np.void]) -> tuple[Float32Array, Float32Array | None]:
    """Return the finite points of records of any shape and of a type of `point_dtype`, as `finite_points` does."""
    return finite_points(*(records[name].reshape(-1) for name in records.dtype.names or ()))


def finite_points(
    x: Column, y: Column, z: Column, intensity: Column | None = None
) -> tuple[Float32Array, Float32Array | None]:
    """Convert columns (N,) of any number type to read-only float32 points (K, 3), finite ones only, in order."""
    points_m = np.empty((len(x), 3), np.float32)
    with np.errstate(over="ignore"):
        for axis, column in enumerate((x, y, z)):
            # Two steps: from packed records, NumPy copies to contiguous memory ten times as fast as to strided one.
            points_m[:, axis] = column.astype(np.float32)
        values = None if intensity is None else intensity.astype(np.float32)
    # One pass without a temporary array; a sum of squares that overflows only leads to the longer way.
    flat = points_m.reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        all_finite = np.isfinite(np.dot(flat, flat))
    if not all_finite:
        finite = np.isfinite(points_m)
        keep = finite[:, 0] & finite[:, 1] & finite[:, 2]
        points_m, values = points_m[keep], None if values is None else values[keep]
    for array in (points_m, values):
        if array is not None:
            # A scan then keeps it without a copy.
            array.setflags(write=False)
    return points_m, values


def encode_points(points_m: Float32Array, intensity: Float32Array | None = None) -> PointCloud2:
    """Pack points (N, 3), with intensities (N,) if there are any, as rows of little-endian float32."""
    columns = [*np.asarray(points_m).T, *([] if intensity is None else [intensity])]
    names = (*_COORDINATES, _INTENSITY)[: len(columns)]
    packed = np.stack(columns, axis=1).astype("<f4", order="C")
    fields = tuple(PointField(name, 4 * index, _FLOAT32) for index, name in enumerate(names))
    point_step = 4 * len(names)
    data = packed.reshape(-1).view(np.uint8)
    return PointCloud2(fields, len(packed), 1, point_step, len(packed) * point_step, data)
