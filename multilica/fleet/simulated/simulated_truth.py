# SPDX-License-Identifier: Apache-2.0
"""The truth file of a simulated fleet."""

import json
from datetime import UTC, datetime
from typing import Any

import numpy as np

from multilica.geometry import RigidTransform
from multilica.simulate import FleetPlan, PlannedLog
from multilica.simulate.fleet_events import PlannedEvent

FLEET_TRUTH_SCHEMA = "multilica/fleet-truth/1"
TRUTH_NAME = "fleet.truth.json"


def fleet_truth(plan: FleetPlan) -> dict[str, Any]:
    """Return what is true of a fleet as values for JSON: vehicles, logs with poses, events."""
    return {
        "schema": FLEET_TRUTH_SCHEMA,
        "rig": plan.rig,
        "target": plan.target,
        "vehicles": list(plan.build_seeds),
        "logs": [_log(plan, log) for log in plan.logs],
        "events": [_event(plan, event) for event in plan.events],
    }


def fleet_truth_text(plan: FleetPlan) -> str:
    """Return the truth as JSON, an entry per line: hundreds of logs stay easy to read and compare."""
    truth = fleet_truth(plan)
    heads = [f"  {json.dumps(key)}: {json.dumps(truth[key])}" for key in ("schema", "rig", "target", "vehicles")]
    lists = [f'  "{key}": [\n{_lines(truth[key])}\n  ]' for key in ("logs", "events")]
    return "{\n" + ",\n".join(heads + lists) + "\n}\n"


def _lines(entries: list[dict[str, Any]]) -> str:
    return ",\n".join(f"    {json.dumps(entry, allow_nan=False)}" for entry in entries)


def _log(plan: FleetPlan, log: PlannedLog) -> dict[str, Any]:
    return {
        "path": log.path,
        "vehicle": log.vehicle,
        "time": _iso(log.time_ns),
        "format": log.format,
        "scene": log.scene,
        "broken": log.fault or None,
        "duplicate_of": log.duplicate_of or None,
        "dead": list(log.dead),
        "T_target_lidar": {name: _pose(pose) for name, pose in plan.true_poses(log).items()},
    }


def _event(plan: FleetPlan, event: PlannedEvent) -> dict[str, Any]:
    """Describe an event; the size of a creep is that within 30 days."""
    first = plan.logs_of(event.vehicle)[event.first_log]
    is_dead = event.kind == "dead"
    return {
        "vehicle": event.vehicle,
        "lidar": event.lidar,
        "kind": event.kind,
        "first_log": first.path,
        "first_log_time": _iso(first.time_ns),
        "shift_m": None if is_dead else float(np.linalg.norm(event.shift_m)),
        "turn_deg": None if is_dead else float(np.rad2deg(np.linalg.norm(event.turn_rad))),
    }


def _pose(pose: RigidTransform) -> dict[str, float]:
    """Return a pose under the names of the columns of tables."""
    values = (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist())
    return dict(zip(("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), values, strict=True))


def _iso(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).isoformat().replace("+00:00", "Z")
