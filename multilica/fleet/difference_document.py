# SPDX-License-Identifier: Apache-2.0
"""A difference of runs as plain values that every JSON reader takes."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from multilica.fleet.difference import Move, RunDifference

__all__ = ["DIFFERENCE_SCHEMA", "difference_document"]

DIFFERENCE_SCHEMA = "multilica/difference/1"


def difference_document(difference: RunDifference) -> dict[str, Any]:
    """What `multilica diff --json` prints.

    Lengths are in metres, angles in degrees; whatever is not known is null.
    """
    return {
        "schema": DIFFERENCE_SCHEMA,
        "runs": list(difference.names),
        "same": difference.same,
        "target": difference.target,
        "targets": list(difference.targets),
        "moves": {move.lidar: _move(move) for move in difference.moves},
        "placed_by_neither": {each.lidar: {"before": each.before, "after": each.after} for each in difference.neither},
        "statuses": {change.lidar: asdict(change) for change in difference.statuses},
        "first_difference": difference.partings[0].step if difference.partings else None,
        "differences": {
            parting.step: [asdict(change) for change in parting.changes] for parting in difference.partings
        },
        "notes": list(difference.notes),
    }


def _move(move: Move) -> dict[str, Any]:
    return {
        "moved": move.moved,
        "distance_m": move.error.distance_m,
        "angle_deg": move.error.angle_deg,
        "translation_m": move.error.translation_m.tolist(),
        "rotation_deg": np.rad2deg(move.error.rotation_rad).tolist(),
        "sigmas": move.sigmas,
    }
