# SPDX-License-Identifier: Apache-2.0
"""Scans of a rig that stands still."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.errors import UnknownNameError
from multilica.geometry import Float32Array, FloatArray, RigidTransform, Uint16Array, Uint32Array, read_only

_PER_POINT: dict[str, type[Any]] = {"intensity": np.float32, "rings": np.uint16, "times_ns": np.uint32}


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One frame of one LiDAR.

    Args:
        points_m: (N, 3) finite returns in the LiDAR's own frame, float32.
        stamp_ns: nanoseconds since the epoch; 0 if the format has no time.
        intensity: (N,) or None.
        log_time_ns: when it was recorded, by the clock of the recorder; 0 if the format has no time.
        rings: (N,) number of the laser or row that measured a point, by the driver's count, or None.
        times_ns: (N,) time of each point after the stamp, or None. Readers leave it out.
    """

    points_m: Float32Array
    stamp_ns: int = 0
    intensity: Float32Array | None = None
    log_time_ns: int = 0
    rings: Uint16Array | None = None
    times_ns: Uint32Array | None = None

    def __post_init__(self) -> None:
        points_m = read_only(self.points_m, np.float32)
        if points_m.ndim != 2 or points_m.shape[1] != 3:
            raise ValueError(f"expected points of shape (N, 3), found {points_m.shape}")
        object.__setattr__(self, "points_m", points_m)
        for name, dtype in _PER_POINT.items():
            if getattr(self, name) is not None:
                values = read_only(getattr(self, name), dtype)
                if values.shape != (len(points_m),):
                    raise ValueError(f"expected {name} of {len(points_m)} points, found shape {values.shape}")
                object.__setattr__(self, name, values)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        arrays = [self.points_m, *(getattr(self, name) for name in _PER_POINT)]
        return sum(array.nbytes for array in arrays if array is not None)

    def selected(self, kept: npt.NDArray[np.bool_] | slice) -> "Scan":
        """Return the scan with some of its points only."""
        values = {name: getattr(self, name) for name in _PER_POINT}
        selected = {name: array[kept] for name, array in values.items() if array is not None}
        return replace(self, points_m=self.points_m[kept], **selected)


@dataclass(frozen=True, slots=True, eq=False)
class LidarScans:
    """Frames of one LiDAR, oldest first.

    Args:
        scans: at least one frame.
        frame_id: frame id of the recording; the name if the format has none.
        topic: topic or file that the frames come from.
    """

    name: str
    scans: tuple[Scan, ...]
    frame_id: str = ""
    topic: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("a LiDAR needs a name")
        object.__setattr__(self, "scans", tuple(self.scans))
        object.__setattr__(self, "frame_id", self.frame_id or self.name)

    @property
    def points_m(self) -> FloatArray:
        """(N, 3) all frames accumulated, float64."""
        if not self.scans:
            return np.empty((0, 3))
        return np.concatenate([scan.points_m for scan in self.scans]).astype(np.float64)

    @property
    def rings(self) -> Uint16Array | None:
        """(N,) ring of each point of all frames; None if a frame with points has none."""
        filled = [scan for scan in self.scans if len(scan.points_m)]
        rings = [scan.rings for scan in filled if scan.rings is not None]
        return np.concatenate(rings) if rings and len(rings) == len(filled) else None

    @property
    def points_count(self) -> int:
        """Number of returns over all frames."""
        return sum(len(scan.points_m) for scan in self.scans)

    def returns_at(self, rows: npt.NDArray[np.int64]) -> Float32Array:
        """Return some of the returns (K, 3) by their numbers (K,) over all frames, which ascend."""
        found, first = [np.empty((0, 3), dtype=np.float32)], 0
        for scan in self.scans:
            begin, end = np.searchsorted(rows, (first, first + len(scan.points_m)))
            found.append(scan.points_m[rows[begin:end] - first])
            first += len(scan.points_m)
        return np.concatenate(found)


@dataclass(frozen=True, slots=True, eq=False)
class LidarMotion:
    """Motion of one LiDAR from the previous stop of a drive to this one, by its own frames on the way.

    Args:
        T_before_now: the LiDAR at this stop in its own frame at the previous one; both frames have its name.
        covariance: (6, 6) rotation (rad), translation (m) along the axes at the previous stop, the rotation about the
            LiDAR's origin at this stop.
        way_m: length of the way of the LiDAR.
        frames: number of frames that were registered.
    """

    lidar: str
    T_before_now: RigidTransform
    covariance: FloatArray
    way_m: float
    frames: int


ReadMotions = Callable[[], tuple[LidarMotion, ...]]
"""Reads the motions of LiDARs from one stop to the next, as far as frames on the way show them."""


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A rig's LiDARs over one stationary window.

    Args:
        lidars: one entry per LiDAR, names unique, sorted by name.
        source: name of the file without folders, or address; "" if the snapshot was made in memory.
        source_sha256: hash of the bytes that were read, "" if the snapshot was made in memory.
        static_transforms: `/tf_static` of the recording, parent frame as target, child frame as source; for ROS 1 also
            what static publishers repeat on `/tf`.
        notes: findings of the reader that the user should know ("12 of 20 scans, then the file ends").
        reading_s: duration of reading in seconds; 0 if the snapshot was made in memory.
        read_motions: of the LiDARs since the previous stop of a drive; None without frames on the way.
    """

    lidars: tuple[LidarScans, ...]
    source: str = ""
    source_sha256: str = ""
    static_transforms: tuple[RigidTransform, ...] = ()
    notes: tuple[str, ...] = ()
    reading_s: float = 0.0
    read_motions: ReadMotions | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "lidars", tuple(sorted(self.lidars, key=lambda lidar: lidar.name)))
        if len(set(self.names)) != len(self.lidars):
            raise ValueError(f"LiDAR names must be unique, found {list(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """LiDAR names in order."""
        return tuple(lidar.name for lidar in self.lidars)

    def __getitem__(self, name: str) -> LidarScans:
        """Return the LiDAR of that name.

        Raises:
            UnknownNameError: the snapshot has no such LiDAR.
        """
        if name not in self.names:
            raise UnknownNameError("LiDAR", name, self.names, self.source)
        return self.lidars[self.names.index(name)]
