# SPDX-License-Identifier: Apache-2.0
"""Scans of a rig that stands still."""

from dataclasses import dataclass

import numpy as np

from multilica.errors import UnknownNameError
from multilica.geometry import Float32Array, FloatArray, RigidTransform, read_only


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One frame of one LiDAR.

    Args:
        points_m: (N, 3) finite returns in the LiDAR's own frame, float32.
        stamp_ns: nanoseconds since the epoch; 0 if the format has no time.
        intensity: (N,) or None.
        log_time_ns: when it was recorded, by the clock of the recorder; 0 if the format has no time.
    """

    points_m: Float32Array
    stamp_ns: int = 0
    intensity: Float32Array | None = None
    log_time_ns: int = 0

    def __post_init__(self) -> None:
        points_m = read_only(self.points_m, np.float32)
        if points_m.ndim != 2 or points_m.shape[1] != 3:
            raise ValueError(f"expected points of shape (N, 3), found {points_m.shape}")
        object.__setattr__(self, "points_m", points_m)
        if self.intensity is not None:
            intensity = read_only(self.intensity, np.float32)
            if intensity.shape != (len(points_m),):
                raise ValueError(f"expected {len(points_m)} intensities, found shape {intensity.shape}")
            object.__setattr__(self, "intensity", intensity)


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
    def points_count(self) -> int:
        """Number of returns over all frames."""
        return sum(len(scan.points_m) for scan in self.scans)


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A rig's LiDARs over one stationary window.

    Args:
        lidars: one entry per LiDAR, names unique, sorted by name.
        source_sha256: hash of the bytes that were read, "" if the snapshot was made in memory.
        static_transforms: `/tf_static` of the recording, parent frame as target, child frame as source.
        notes: findings of the reader that the user should know ("12 of 20 scans, then the file ends").
        reading_s: duration of reading in seconds; 0 if the snapshot was made in memory.
    """

    lidars: tuple[LidarScans, ...]
    source: str = ""
    source_sha256: str = ""
    static_transforms: tuple[RigidTransform, ...] = ()
    notes: tuple[str, ...] = ()
    reading_s: float = 0.0

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
