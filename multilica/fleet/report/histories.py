# SPDX-License-Identifier: Apache-2.0
"""Histories of LiDARs from the rows of the table `lidars`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.fleet.report.contents import LidarHistory
from multilica.fleet.store.store import Store
from multilica.geometry import FloatArray

_ROWS = """
SELECT vehicle, lidar, target, CASE WHEN time < TIMESTAMPTZ '2262-01-01' THEN epoch_ns(time) END AS time_ns, how,
       status, source, x_m, y_m, z_m, qx, qy, qz, qw, covariance
FROM lidars WHERE lidar <> target AND vehicle IN (SELECT unnest(?))
ORDER BY vehicle, lidar, target, time NULLS LAST, source, key
"""
_MM = 1e3


def read_histories(store: Store, vehicles: Sequence[str]) -> dict[str, tuple[LidarHistory, ...]]:
    """Return the histories of the LiDARs of vehicles, without their targets, which rest by definition."""
    from multilica.fleet.store.query import ask

    if not vehicles:
        return {}
    with ask(store, _ROWS, [list(vehicles)]) as answer:
        rows = (dict(zip(answer.columns, row, strict=True)) for row in answer.rows())
        return {vehicle: tuple(_histories(own)) for vehicle, own in groupby(rows, key=lambda row: str(row["vehicle"]))}


def _histories(rows: Iterable[dict[str, Any]]) -> Iterator[LidarHistory]:
    for (lidar, target), found in groupby(rows, key=lambda row: (row["lidar"], row["target"])):
        yield _history(lidar, target, list(found))


def _history(lidar: str, target: str, rows: Sequence[dict[str, Any]]) -> LidarHistory:
    dated = [row for row in rows if row["time_ns"] is not None]
    posed = [row for row in dated if row["x_m"] is not None]
    return LidarHistory(
        lidar,
        target,
        np.array([row["time_ns"] for row in posed], dtype=np.int64),
        _offsets(posed),
        np.array([_sigmas(row["covariance"]) for row in posed]).reshape(-1, 6),
        np.array([row["how"] == "calibrated" for row in posed], dtype=np.bool_),
        np.array([row["status"] == "uncertain" for row in posed], dtype=np.bool_),
        tuple(row["source"] for row in posed),
        np.array([row["time_ns"] for row in dated if row["x_m"] is None], dtype=np.int64),
        len(rows) - len(dated),
    )


def _offsets(rows: Sequence[dict[str, Any]]) -> FloatArray:
    """Return offsets (N, 6) from the median pose: shift (mm), then rotation (deg), along the target's axes."""
    if not rows:
        return np.empty((0, 6))
    xyz_m = np.array([[row[name] for name in ("x_m", "y_m", "z_m")] for row in rows])
    rotations = Rotation.from_quat([[row[name] for name in ("qx", "qy", "qz", "qw")] for row in rows])
    turns_rad = (rotations * _middle(rotations).inv()).as_rotvec()
    turns_rad -= np.median(turns_rad, axis=0)
    return np.hstack([_MM * (xyz_m - np.median(xyz_m, axis=0)), np.rad2deg(turns_rad)])


def _middle(rotations: Rotation) -> Rotation:
    """Return the rotation that is closest to all others, which no few outliers move."""
    quaternions = rotations.as_quat()
    some = quaternions[:: 1 + len(quaternions) // 1000]
    cosines = np.abs(some @ some.T).clip(max=1.0)
    return Rotation.from_quat(some[int(np.argmin(np.arccos(cosines).sum(axis=0)))])


def _sigmas(covariance: Sequence[float] | None) -> FloatArray:
    """Return standard deviations (6,) in the order and units of offsets."""
    if covariance is None:
        return np.full(6, np.nan)
    deviations = np.sqrt(np.diag(np.reshape(covariance, (6, 6))).clip(min=0.0))
    return np.concatenate([_MM * deviations[3:], np.rad2deg(deviations[:3])])
