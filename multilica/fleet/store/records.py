# SPDX-License-Identifier: Apache-2.0
"""Rows of the fleet's tables, and their written schema."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal

import pyarrow as pa

from multilica.fleet.times import moment

SCHEMA_VERSION = 1
LogState = Literal["verified", "calibrated", "refused", "failed", "duplicate"]
PASSING = ("network", "killed")
"""Reasons of a failure that may be gone the next time; such a log is taken up again by the next run."""
MEASURED = ("elapsed_s", "cpu_s", "memory_mb", "artifacts_mb", "attempts", "finished_at")
"""Columns of `logs` that are measured, so that they differ between equal runs."""


@dataclass(frozen=True, slots=True)
class LidarRow:
    """The pose of one LiDAR in one log.

    Args:
        key: of the log's row.
        how: ``verified`` from the vehicle's last accepted poses, or ``calibrated`` without them.
        status: as in `result.json`.
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
    """What became of one log.

    Args:
        key: of source, configuration and version; the name of its files in the store.
        source: path below what was given, or address without secrets.
        fingerprint: of the source, from size and content or the server's etag.
        reason: stable name of why the log is refused, failed or a duplicate; empty else.
        reference: path in the store of the poses that it was verified against; empty if there were none.
        calibration: path in the store of the poses that hold after it; empty if there are none.
        recording, report, mcap: paths in the store; empty if not written.
        placed: LiDARs with a pose.
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


_TIME = pa.timestamp("us", tz="UTC")
_TEXT = pa.string()
_NUMBER = pa.float64()


def _schema(name: str, fields: Sequence[tuple[str, pa.DataType]]) -> pa.Schema:
    metadata = {"multilica.table": name, "multilica.schema_version": str(SCHEMA_VERSION)}
    return pa.schema([pa.field(*field) for field in fields], metadata=metadata)


LIDARS_SCHEMA = _schema(
    "lidars",
    [
        ("key", _TEXT),
        ("time", _TIME),
        ("source", _TEXT),
        ("lidar", _TEXT),
        ("target", _TEXT),
        ("how", _TEXT),
        ("status", _TEXT),
        ("reason", _TEXT),
        ("reason_text", _TEXT),
        *((name, _NUMBER) for name in ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")),
        ("covariance", pa.list_(_NUMBER)),
        ("sigma_mm", _NUMBER),
        ("sigma_deg", _NUMBER),
        ("evidence", _NUMBER),
    ],
)
"""Schema of the parts of `lidars`; the folders of a part give `vehicle` and `month`."""
LOGS_SCHEMA = _schema(
    "logs",
    [
        ("key", _TEXT),
        ("time", _TIME),
        ("source", _TEXT),
        ("fingerprint", _TEXT),
        ("size_bytes", pa.int64()),
        ("state", _TEXT),
        ("reason", _TEXT),
        ("reason_text", _TEXT),
        ("source_sha256", _TEXT),
        ("lidars", pa.int32()),
        ("placed", pa.int32()),
        ("reference", _TEXT),
        ("calibration", _TEXT),
        ("recording", _TEXT),
        ("report", _TEXT),
        ("mcap", _TEXT),
        ("version", _TEXT),
        ("config_sha256", _TEXT),
        ("elapsed_s", _NUMBER),
        ("cpu_s", _NUMBER),
        ("memory_mb", _NUMBER),
        ("artifacts_mb", _NUMBER),
        ("attempts", pa.int32()),
        ("finished_at", _TIME),
    ],
)
"""Schema of the parts of `logs`; the folders of a part give `vehicle` and `month`."""


def table_of(rows: Sequence[LidarRow] | Sequence[LogRow], schema: pa.Schema) -> pa.Table:
    """Return rows as a table."""
    values = [_values(row) for row in rows]
    return pa.Table.from_pylist([{name: value[name] for name in schema.names} for value in values], schema=schema)


def _values(row: LidarRow | LogRow) -> dict[str, Any]:
    values = asdict(row)
    values["time"] = None if row.time_ns is None else moment(row.time_ns)
    return values
