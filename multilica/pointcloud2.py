# SPDX-License-Identifier: Apache-2.0
"""The data layout of `sensor_msgs/PointCloud2`."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from multilica.geometry import Float32Array, Uint16Array, Uint32Array
from multilica.snapshot import Scan

DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""`PointField.datatype` -> NumPy type without its byte order."""

LIDAR_NAME_KEY = "multilica:lidar"
"""Key of the LiDAR's name in the metadata of an MCAP channel of point clouds."""
SNAPSHOT_METADATA_NAME = "multilica:snapshot"
"""The metadata record of an MCAP file of a snapshot; `frames` is the requested number per LiDAR."""

MERGED_TOPIC = "/multilica/points"
"""Topic of the clouds of all LiDARs in one frame, as `multilica publish` sends them."""

Column = npt.NDArray[Any]

_COORDINATES = ("x", "y", "z")
_INTENSITY = "intensity"
_RING = "ring"
RING_NAMES = (_RING, "channel", "line", "laser_id")
"""Names of drivers for the number of a point's laser; the first that a cloud has is read."""
_TIME = "time"
_TIME_NAMES = ("t", _TIME, "timestamp", "time_stamp", "offset_time")
"""Names of drivers for the time of a point: in seconds if not whole, or in a smaller unit."""
_LONGEST_FRAME_NS = 1_000_000_000
_SHORTEST_FRAME_NS = 1_000_000
_FASTEST_NS, _SLOWEST_NS = 40_000_000, 250_000_000
"""Shortest and longest turn of a LiDAR, from 25 to 4 Hz."""
_LEAST_TURN = 500
"""Points of a turn; a packet has fewer."""
_MOST_SPANS = 10
"""Times that begin later than this many of their spans are since the epoch, or since the sensor was switched on."""
_LEAST_STEPS = 16
"""Fewer different numbers of a float32 within a frame tell no times."""
_UINT16, _UINT32, _FLOAT32 = 4, 6, 7


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
        row_step: bytes from one row to the next; of no meaning with a single row, or where points fill the data.
    """

    fields: tuple[PointField, ...]
    width: int
    height: int
    point_step: int
    row_step: int
    data: bytes | memoryview | npt.NDArray[np.uint8]
    big_endian: bool = False


class Points(NamedTuple):
    """Finite points (N, 3) in the order of the data, with intensities (N,), rings (N,) and times (N,), or None."""

    points_m: Float32Array
    intensity: Float32Array | None = None
    rings: Uint16Array | None = None
    times_ns: Uint32Array | None = None

    def as_scan(self, stamp_ns: int) -> Scan:
        """Return them as one frame."""
        return Scan(self.points_m, stamp_ns, self.intensity, rings=self.rings, times_ns=self.times_ns)


def decode_points(cloud: PointCloud2, *, timed: bool = False) -> Points:
    """Return the finite points of a message.

    Args:
        timed: also read the time of each point after the earliest one.

    Raises:
        ValueError: the message contradicts itself; the text is a predicate, such as "has no field z".
    """
    if cloud.width * cloud.height == 0:
        return Points(np.empty((0, 3), np.float32))
    row_step = _checked_row_step(cloud)
    dtype = point_dtype(cloud.fields, cloud.point_step, big_endian=cloud.big_endian, timed=timed)
    shape, strides = (cloud.height, cloud.width), (row_step, cloud.point_step)
    return finite_records(np.ndarray(shape, dtype, cloud.data, 0, strides))


@lru_cache(maxsize=64)
def point_dtype(
    fields: tuple[PointField, ...], point_step: int, *, big_endian: bool, timed: bool = False
) -> np.dtype[np.void]:
    """Return the structured type of the fields of `read_fields`, by their names there; all others are padding.

    Raises:
        ValueError: a coordinate is missing, of unknown type, or outside the point.
    """
    chosen = read_fields(fields, point_step, timed=timed)
    return np.dtype(
        {
            "names": list(chosen),
            "formats": [_format(field, point_step, big_endian=big_endian) for field in chosen.values()],
            "offsets": [field.offset for field in chosen.values()],
            "itemsize": point_step,
        }
    )


def read_fields(fields: tuple[PointField, ...], point_step: int, *, timed: bool = False) -> dict[str, PointField]:
    """Return x, y, z and, if there are any, intensity, ring and, if wanted, time, by these names.

    Any of these but a coordinate counts as missing if it cannot be read. Other errors are those of `point_dtype`.
    """
    found = {field.name: field for field in reversed(fields)}
    missing = [name for name in _COORDINATES if name not in found]
    if missing:
        listed = ", ".join(field.name for field in fields) or "none"
        raise ValueError(f"has no field {' or '.join(missing)}; its fields are: {listed}")
    if len({found[name].offset for name in _COORDINATES}) < len(_COORDINATES):
        raise ValueError("has two coordinates at the same bytes of each point")
    chosen = {name: found[name] for name in _COORDINATES}
    of_names = {_INTENSITY: (_INTENSITY,), _RING: RING_NAMES, **({_TIME: _TIME_NAMES} if timed else {})}
    for key, names in of_names.items():
        known = [found[name] for name in names if name in found and _is_inside(found[name], point_step)]
        chosen |= dict(zip((key,), known, strict=False))
    return chosen


def _is_inside(field: PointField, point_step: int) -> bool:
    size = np.dtype(DATATYPES[field.datatype]).itemsize if field.datatype in DATATYPES else point_step + 1
    return field.offset + size <= point_step


def _format(field: PointField, point_step: int, *, big_endian: bool) -> np.dtype[Any]:
    if field.datatype not in DATATYPES:
        raise ValueError(f"has field {field.name} of the unknown datatype {field.datatype}; expected 1 to 8")
    dtype = np.dtype((">" if big_endian else "<") + DATATYPES[field.datatype])
    if field.offset + dtype.itemsize > point_step:
        raise ValueError(f"has field {field.name} at byte {field.offset} of points of {point_step} bytes")
    return dtype


def _checked_row_step(cloud: PointCloud2) -> int:
    row_bytes = cloud.width * cloud.point_step
    # Some nodes give the bytes of one point or of all; without padding there is only one layout.
    is_packed = len(cloud.data) == cloud.height * row_bytes
    row_step = cloud.row_step if cloud.height > 1 and cloud.row_step and not is_packed else row_bytes
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


def finite_records(records: npt.NDArray[np.void]) -> Points:
    """Return the finite points of records of any shape and of a type of `point_dtype`, as `finite_points` does."""
    return finite_points(**{name: records[name].reshape(-1) for name in records.dtype.names or ()})


def finite_points(
    x: Column,
    y: Column,
    z: Column,
    intensity: Column | None = None,
    ring: Column | None = None,
    time: Column | None = None,
) -> Points:
    """Convert columns (N,) of any number type to read-only points (K, 3), finite ones only, in order.

    Rings that are no whole numbers from 0 to 65,535 are left out, and so are times that are none of one frame.
    """
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
        ring = None if ring is None else ring[keep]
        time = None if time is None else time[keep]
    rings = None if ring is None else _whole(ring)
    times_ns = None if time is None else _since_first_ns(time)
    for array in (points_m, values, rings, times_ns):
        if array is not None:
            # A scan then keeps it without a copy.
            array.setflags(write=False)
    return Points(points_m, values, rings, times_ns)


def _since_first_ns(times: Column) -> Uint32Array | None:
    """Return nanoseconds after the earliest time (N,); None if they differ by more, or less, than a frame lasts.

    A field may be there without times, or in a unit that the length of a turn does not tell. Lost beams have the time 0
    among times since the epoch, and count as of the earliest one.
    """
    if not len(times) or not np.isfinite(times).all():
        return None
    measured = times != 0
    first, last = _ends(times[measured]) if measured.any() else (0, 0)
    if first <= _MOST_SPANS * (last - first):
        measured[:] = True
        first, last = _ends(times)
    unit_ns = _unit_ns(last - first, is_float=times.dtype.kind == "f", is_turn=len(times) >= _LEAST_TURN)
    if unit_ns is None or (times.dtype.kind == "f" and last - first < _LEAST_STEPS * np.spacing(np.abs(times).max())):
        return None
    since = times - times.dtype.type(first)
    return np.where(measured, since * np.float64(unit_ns) if unit_ns > 1 else since, 0).astype(np.uint32)


def _ends(times: Column) -> tuple[float, float]:
    """Return the earliest and the latest time, as Python's numbers, which do not overflow."""
    return times.min().item(), times.max().item()


def _unit_ns(span: float, *, is_float: bool, is_turn: bool) -> int | None:
    """Return the unit of times that span a frame; None if there is none, or it might be another one.

    A single packet in nanoseconds may span what a turn does in microseconds.
    """
    if is_float and span <= 1.0:
        return _LONGEST_FRAME_NS if span >= _SHORTEST_FRAME_NS / _LONGEST_FRAME_NS else None
    if _SHORTEST_FRAME_NS <= span <= _LONGEST_FRAME_NS:
        return 1
    units_ns = (1_000, 1_000_000) if is_turn else ()
    return next((unit_ns for unit_ns in units_ns if _FASTEST_NS <= span * unit_ns <= _SLOWEST_NS), None)


def _whole(numbers: Column) -> Uint16Array | None:
    with np.errstate(invalid="ignore", over="ignore"):
        whole = numbers.astype(np.uint16)
    return whole if np.can_cast(numbers.dtype, np.uint16) or np.array_equal(whole, numbers) else None


def encode_points(
    points_m: Float32Array,
    intensity: Float32Array | None = None,
    *,
    rings: Uint16Array | None = None,
    times_ns: Uint32Array | None = None,
) -> PointCloud2:
    """Pack points (N, 3) without gaps: x, y, z and, if given, intensity as float32, `t` as uint32, `ring` as uint16.

    Args:
        intensity, rings, times_ns: (N,); `t` is the name of Ouster's driver for nanoseconds after the stamp.
    """
    columns = [*((name, values, _FLOAT32) for name, values in zip(_COORDINATES, np.asarray(points_m).T, strict=True))]
    optional = ((_INTENSITY, intensity, _FLOAT32), ("t", times_ns, _UINT32), (_RING, rings, _UINT16))
    columns += [(name, values, datatype) for name, values, datatype in optional if values is not None]
    packed = np.empty(len(points_m), [(name, f"<{DATATYPES[datatype]}") for name, _, datatype in columns])
    for name, values, _ in columns:
        packed[name] = values
    offsets = {name: offset for name, (_, offset, *_) in (packed.dtype.fields or {}).items()}
    fields = tuple(PointField(name, offsets[name], datatype) for name, _, datatype in columns)
    point_step = packed.dtype.itemsize
    return PointCloud2(fields, len(packed), 1, point_step, len(packed) * point_step, packed.view(np.uint8))
