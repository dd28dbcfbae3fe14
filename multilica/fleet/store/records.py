# SPDX-License-Identifier: Apache-2.0
"""Rows of the fleet's tables, and their written schema."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Literal, get_args, get_type_hints

import numpy as np
import pyarrow as pa

from multilica.geometry import FloatArray, RigidTransform

SCHEMA_VERSION = 1
LogState = Literal["verified", "calibrated", "refused", "failed", "duplicate"]
PASSING = ("network", "killed", "not_found")
"""Reasons of a failure that may be gone the next time; such a log is taken up again by the next run."""
MEASURED = ("elapsed_s", "cpu_s", "memory_mb", "artifacts_mb", "attempts", "finished_at")
"""Columns of `logs` that are measured, so that they differ between equal runs."""
POSE_COLUMNS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
"""Columns of `lidars` with ``T_target_lidar``."""


@dataclass(frozen=True, slots=True)
class LidarRow:
    """The pose of one LiDAR in one log.

    Args:
        how: ``verified`` from the vehicle's last accepted poses, or ``calibrated`` without them.
        reason: stable name of why it is uncertain or not placed; empty if it is placed.
        x_m, y_m, z_m, qx, qy, qz, qw: ``T_target_lidar``; None if it is not placed.
        covariance: rows of (6, 6), order rotation (rad), translation (m), along the target's axes; None if not known.
        sigma_mm, sigma_deg: largest standard deviations of position and rotation.
        evidence: log-odds of the best accepted pair that holds the LiDAR; None where it was verified.
    """

    key: str
    time_ns: int | None
    source: str
    lidar: str
    target: str
    how: Literal["verified", "calibrated"]
    status: Literal["placed", "uncertain", "not_placed"]
    reason: str = ""
    reason_text: str = ""
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    qx: float | None = None
    qy: float | None = None
    qz: float | None = None
    qw: float | None = None
    covariance: tuple[float, ...] | None = None
    sigma_mm: float | None = None
    sigma_deg: float | None = None
    evidence: float | None = None


@dataclass(frozen=True, slots=True)
class LogRow:
    """The outcome of one log.

    Args:
        key: of source, configuration and version; the name of its files in the store.
        source, fingerprint: as of `FleetLog`.
        reason: stable name of why the log is refused, failed or a duplicate; empty else.
        reference: path in the store of the poses that it was verified against; empty if there were none.
        calibration: path in the store of the poses that hold after it; empty if there are none.
        recording, report, mcap: paths in the store; empty if not written.
    """

    key: str
    vehicle: str
    time_ns: int | None
    source: str
    fingerprint: str
    size_bytes: int
    state: LogState
    reason: str = ""
    reason_text: str = ""
    source_sha256: str = ""
    lidars: int = 0
    placed: int = 0
    reference: str = ""
    calibration: str = ""
    recording: str = ""
    report: str = ""
    mcap: str = ""
    version: str = ""
    config_sha256: str = ""
    elapsed_s: float = 0.0
    cpu_s: float = 0.0
    memory_mb: float = 0.0
    artifacts_mb: float = 0.0
    attempts: int = 1
    finished_at: datetime | None = None

    def as_duplicate(self, first: str) -> LogRow:
        """Return the row of a log with the same bytes as the log `first`."""
        return replace(self, state="duplicate", reason="duplicate", reason_text=f"the same bytes as {first}")


def with_pose(row: LidarRow, pose: RigidTransform, covariance: FloatArray | None) -> LidarRow:
    """Return the row of a LiDAR with its pose, and with the covariance of the pose if that is known."""
    values = zip(POSE_COLUMNS, (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist()), strict=True)
    row = replace(row, **dict(values))
    if covariance is None:
        return row
    blocks = np.stack([covariance[:3, :3], covariance[3:, 3:]])
    sigma_rad, sigma_m = np.sqrt(np.linalg.eigvalsh(blocks)[:, -1].clip(min=0.0)).tolist()
    flat, sigma_deg = tuple(covariance.ravel().tolist()), float(np.rad2deg(sigma_rad))
    return replace(row, covariance=flat, sigma_mm=1000.0 * sigma_m, sigma_deg=sigma_deg)


_ARROW_TYPES = {
    str: pa.string(),
    int: pa.int32(),
    float: pa.float64(),
    tuple[float, ...]: pa.list_(pa.float64()),
    datetime: pa.timestamp("us", tz="UTC"),
}


def _schema(table: str, row: type[LidarRow | LogRow]) -> pa.Schema:
    """Return a schema with a column for each field of a row; the folders of a part give `vehicle` and `month`."""
    columns = []
    for name, hint in get_type_hints(row).items():
        kind = next((each for each in (hint, *get_args(hint)) if each in _ARROW_TYPES), str)
        if name == "time_ns":
            columns.append(pa.field("time", _ARROW_TYPES[datetime]))
        elif name != "vehicle":
            columns.append(pa.field(name, pa.int64() if name == "size_bytes" else _ARROW_TYPES[kind]))
    metadata = {"multilica.table": table, "multilica.schema_version": str(SCHEMA_VERSION)}
    return pa.schema(columns, metadata=metadata)


TABLES = {"lidars": _schema("lidars", LidarRow), "logs": _schema("logs", LogRow)}


def table_of(rows: Sequence[LidarRow] | Sequence[LogRow], schema: pa.Schema) -> pa.Table:
    """Return rows as a table."""
    values = [asdict(row) | {"time": None if row.time_ns is None else moment(row.time_ns)} for row in rows]
    return pa.Table.from_pylist([{name: value[name] for name in schema.names} for value in values], schema=schema)


def moment(time_ns: int) -> datetime:
    """Return nanoseconds since the epoch as a time, to the microsecond."""
    return datetime.fromtimestamp(time_ns // 10**9, UTC).replace(microsecond=time_ns % 10**9 // 1000)


def day_of(time_ns: int) -> str:
    """Return the day of a time, such as ``2026-03-01``."""
    return f"{moment(time_ns):%Y-%m-%d}"


def month_of(time_ns: int | None) -> str:
    """Return the month of a time, such as ``2026-03``; ``unknown`` without a time."""
    return "unknown" if time_ns is None else f"{moment(time_ns):%Y-%m}"
