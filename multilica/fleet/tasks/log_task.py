# SPDX-License-Identifier: Apache-2.0
"""Request to a task, with the rows of logs without a result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict

import multilica
from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.fleet.store.records import LogRow

Calibrate = Literal["when-needed", "always"]

_SHARED = ("key", "vehicle", "time_ns", "source", "fingerprint", "size_bytes", "config_sha256", "reference")
"""Fields of a task that are also fields of its row."""


class LogTask(BaseModel):
    """The input of a worker for one log.

    Attributes:
        reference: path in the store of the vehicle's last accepted poses; empty if there are none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    key: str
    address: str
    source: str
    fingerprint: str
    size_bytes: int
    vehicle: str
    time_ns: int | None
    store: str
    config: CalibrationConfig
    config_sha256: str
    tolerances: RigTolerances
    calibrate: Calibrate
    reference: str
    attempt: int = 1

    def row(self) -> LogRow:
        """Return the part of the row that is known beforehand."""
        known = {name: getattr(self, name) for name in _SHARED}
        version = multilica.__version__
        return LogRow(**known, state="failed", version=version, calibration=self.reference, attempts=self.attempt)


@dataclass(frozen=True, slots=True)
class LogTaskFailure:
    """Reason why a task ended without a row."""

    reason: str
    text: str


def failed_row(request: LogTask, reason: str, text: str, *, state: Literal["refused", "failed"] = "failed") -> LogRow:
    """Return the row of a log without a result; the poses that held before it still hold."""
    told = text.replace(request.address, request.source)
    return replace(request.row(), state=state, reason=reason, reason_text=told, finished_at=datetime.now(UTC))
