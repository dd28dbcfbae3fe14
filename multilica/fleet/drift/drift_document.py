# SPDX-License-Identifier: Apache-2.0
"""The output of `multilica fleet drift --json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from multilica.fleet.drift.drift import DriftEvent
from multilica.fleet.drift.fleet_offsets import FleetOffset
from multilica.fleet.drift.stored_series import Outage
from multilica.fleet.store.records import moment
from multilica.geometry import FloatArray


def drift_document(
    events: Sequence[DriftEvent], offsets: Sequence[FleetOffset], outages: Sequence[Outage]
) -> dict[str, Any]:
    """Return plain values: times in ISO 8601, lengths in metres, angles in degrees, along the target's axes."""
    return {
        "schema": "multilica/drift/1",
        "moved": [
            {
                "vehicle": each.vehicle,
                "lidars": list(each.lidars),
                "target": each.target,
                "kind": each.kind,
                "moved": each.moved,
                "first_log": each.key,
                "first_time": _time(each.time_ns),
                "last_before_log": each.last_before_key,
                "last_before_time": _time(each.last_before_time_ns),
                **_motion(each.translation_m, each.rotation_rad),
                "p_value": each.p_value,
                "sentence": each.sentence,
            }
            for each in events
        ],
        "offset": [
            {
                "lidar": each.lidar,
                "scope": each.scope,
                "vehicle": each.vehicle,
                "vehicles": each.vehicles,
                **_motion(each.translation_m, each.rotation_rad),
                "p_value": each.p_value,
                "sentence": each.sentence,
            }
            for each in offsets
        ],
        "lost": [
            {
                "vehicle": each.vehicle,
                "lidar": each.lidar,
                "reason": each.reason,
                "first_log": each.key,
                "first_time": _time(each.time_ns),
                "last_time": _time(each.last_time_ns),
                "logs": each.logs,
                "lasts": each.lasts,
                "sentence": each.sentence,
            }
            for each in outages
        ],
    }


def _motion(translation_m: FloatArray, rotation_rad: FloatArray) -> dict[str, list[float]]:
    return {"translation_m": translation_m.tolist(), "rotation_deg": np.rad2deg(rotation_rad).tolist()}


def _time(time_ns: int) -> str:
    return moment(time_ns).isoformat()
