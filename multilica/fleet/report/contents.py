# SPDX-License-Identifier: Apache-2.0
"""Contents of the report of a fleet."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, read_only

EventKind = Literal["jump", "creep", "lost", "offset"]


@dataclass(frozen=True, slots=True)
class FleetOverview:
    """What the page shows of the whole store.

    Args:
        store: its address, for people.
        version: of multilica.
        files: relative path of the store as seen from the page, "" if the page lies in its top folder; None if no file
            of the store can be linked.
    """

    store: str
    version: str
    files: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LidarHistory:
    """Poses of one LiDAR over the logs of its vehicle, as offsets from their median.

    Args:
        time_ns: (N,) of the logs with a pose, ascending.
        offsets: (N, 6) shift along x, y, z (mm) and rotation about x, y, z (deg), along the target's axes.
        sigmas: (N, 6) their standard deviations; NaN where not known.
        calibrated: (N,) whether the pose was calibrated, not verified.
        uncertain: (N,) whether the pose is uncertain.
        sources: (N,) names of the logs.
        missing_ns: (M,) times of the logs without a pose.
        undated: number of the logs without a time, which are not in the arrays.
    """

    lidar: str
    target: str
    time_ns: npt.NDArray[np.int64]
    offsets: FloatArray
    sigmas: FloatArray
    calibrated: npt.NDArray[np.bool_]
    uncertain: npt.NDArray[np.bool_]
    sources: tuple[str, ...]
    missing_ns: npt.NDArray[np.int64]
    undated: int = 0

    def __post_init__(self) -> None:
        for name, dtype in (("time_ns", np.int64), ("missing_ns", np.int64), ("calibrated", np.bool_)):
            object.__setattr__(self, name, read_only(getattr(self, name), dtype))
        for name in ("offsets", "sigmas"):
            object.__setattr__(self, name, read_only(getattr(self, name), np.float64))

    @property
    def distances_mm(self) -> FloatArray:
        """(N,) distances to the median position."""
        return np.asarray(np.linalg.norm(self.offsets[:, :3], axis=1))

    @property
    def angles_deg(self) -> FloatArray:
        """(N,) angles to the median rotation."""
        return np.asarray(np.linalg.norm(self.offsets[:, 3:], axis=1))


@dataclass(frozen=True, slots=True)
class PageVehicle:
    """A row of the overview, and the section of a vehicle.

    Args:
        first, last: times of its first and last log; None without a time.
        without_result: logs that are refused or failed.
        not_placed_last: LiDARs without a certain pose in the last log with a result, with reasons.
        histories: of its LiDARs except the target; empty if they were not read.
    """

    name: str
    logs: int
    first: datetime | None
    last: datetime | None
    verified: int
    calibrated: int
    without_result: int
    duplicates: int
    not_placed_last: tuple[str, ...] = ()
    histories: tuple[LidarHistory, ...] = ()


@dataclass(frozen=True, slots=True)
class PageEvent:
    """A LiDAR that moved on its vehicle, has no pose in several logs, or sits elsewhere than on other vehicles.

    Args:
        part: which one, for people.
        lidars: whose poses are concerned.
        when: in words; empty for an offset, which all logs have.
        begin_ns, end_ns: of a jump, the last log before and the first one after; else the first and the last log; None
            for an offset.
        translation_mm, rotation_deg: lengths of the motion; None if there is none.
    """

    vehicle: str
    part: str
    lidars: tuple[str, ...]
    kind: EventKind
    sentence: str
    when: str = ""
    begin_ns: int | None = None
    end_ns: int | None = None
    translation_mm: float | None = None
    rotation_deg: float | None = None


@dataclass(frozen=True, slots=True)
class PageFailure:
    """A log without a result, or a LiDAR without a certain pose in a log.

    Args:
        lidar: empty if it is the whole log.
        outcome: state of the log, or status of the LiDAR.
        recording: path in the store; empty if there is none.
    """

    vehicle: str
    time: datetime | None
    source: str
    lidar: str
    outcome: str
    reason: str
    sentence: str
    recording: str = ""
