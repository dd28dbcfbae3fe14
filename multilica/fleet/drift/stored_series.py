# SPDX-License-Identifier: Apache-2.0
"""The poses of a store as series, and LiDARs that are lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby

import numpy as np

from multilica.fleet.drift.lidar_series import LidarSeries
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store
from multilica.geometry import RigidTransform

# One log without a pose is told by `fleet failures`; two in a row are no accident of the scene.
_LEAST_LOGS = 2
_SERIES = """
SELECT vehicle, lidar, target, key, epoch_ns(time) AS time_ns, x_m, y_m, z_m, qx, qy, qz, qw, covariance
FROM lidars WHERE status <> 'not_placed' AND lidar <> target AND time IS NOT NULL AND len(covariance) = 36
ORDER BY vehicle, lidar, target, time, key
"""
_STATES = """
SELECT vehicle, lidar, CASE WHEN status = 'not_placed' THEN reason ELSE '' END AS lost, key, epoch_ns(time) AS time_ns
FROM lidars WHERE time IS NOT NULL ORDER BY vehicle, lidar, time, key
"""
_WORDS = {"dead_sensor": "returns nothing", "dirty_sensor": "has a dirty window"}


@dataclass(frozen=True, slots=True)
class Outage:
    """A LiDAR without a pose in two or more logs in a row, for one cause.

    Args:
        reason: stable name of the cause.
        key, time_ns: of the first of these logs.
        last_time_ns: time of the last of them.
        logs: number of them.
        lasts: whether its last log is one of them.
    """

    vehicle: str
    lidar: str
    reason: str
    key: str
    time_ns: int
    last_time_ns: int
    logs: int
    lasts: bool

    @property
    def sentence(self) -> str:
        """The outage in one sentence, for people; dates are UTC."""
        what = _WORDS.get(self.reason, f"is not placed ({self.reason.replace('_', ' ')})")
        since = f"since {_date(self.time_ns)}" if self.lasts else f"{_date(self.time_ns)} to {_date(self.last_time_ns)}"
        return f"{self.vehicle}: {self.lidar} {what} {since}, in {self.logs} logs."


def read_series(store: Store) -> Iterator[LidarSeries]:
    """Yield the poses of each LiDAR of each vehicle, relative to each target that its logs have."""
    with ask(store, _SERIES) as answer:
        for (vehicle, lidar, target), group in groupby(answer.rows(), key=lambda row: row[:3]):
            rows = [row[3:] for row in group]
            yield LidarSeries(
                vehicle,
                lidar,
                target,
                tuple(key for key, *_ in rows),
                np.array([time_ns for _, time_ns, *_ in rows], dtype=np.int64),
                tuple(RigidTransform.from_xyz_quaternion(target, lidar, row[2:5], row[5:9]) for row in rows),
                np.array([row[9] for row in rows]).reshape(-1, 6, 6),
            )


def find_outages(store: Store) -> list[Outage]:
    """Find the LiDARs that have no pose in several logs in a row, in the order of vehicles and LiDARs."""
    outages = []
    with ask(store, _STATES) as answer:
        for (vehicle, lidar), group in groupby(answer.rows(), key=lambda row: row[:2]):
            rows = list(group)
            for reason, spell in groupby(rows, key=lambda row: row[2]):
                logs = list(spell)
                if reason and len(logs) >= _LEAST_LOGS:
                    (*_, key, time_ns), last = logs[0], logs[-1]
                    outages.append(
                        Outage(vehicle, lidar, reason, key, time_ns, last[4], len(logs), lasts=last is rows[-1])
                    )
    return outages


def _date(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).strftime("%Y-%m-%d")
