# SPDX-License-Identifier: Apache-2.0
"""Writer of the logs of a simulated fleet, with their truth."""

import json
import shutil
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from multilica.documents import LFS_POINTER
from multilica.errors import UsageError
from multilica.fleet.store.records import POSE_COLUMNS
from multilica.optional_libraries import require_library
from multilica.simulate import FleetPlan, PlannedLog, simulate_snapshot, thinned
from multilica.simulate.fleet import PlannedEvent
from multilica.sinks.files.atomic import atomic_file, write_text_atomically
from multilica.sinks.snapshots import write_ros1_bag, write_ros2_bag, write_ros2_mcap, write_snapshot_mcap
from multilica.workers import Shared, open_workers

FLEET_TRUTH_SCHEMA = "multilica/fleet-truth/1"
TRUTH_NAME = "fleet.truth.json"

_MODULES = ("multilica.fleet.simulated_logs", "multilica.registration.lazy_open3d")
_CONTENTS: Mapping[str, bytes] = {
    "zeros": bytes(200_000),
    "empty": b"",
    "text": b"The logger was restarted before the upload; see the ticket.\n",
    "lfs_pointer": LFS_POINTER + b"v1\noid sha256:" + b"0" * 64 + b"\nsize 734003\n",
}


def write_fleet(
    plan: FleetPlan, out: Path, *, workers: int = 0, observe: Callable[[PlannedLog], None] = lambda _: None
) -> Path:
    """Write all logs of a fleet, then ``fleet.truth.json``; the same plan gives the same bytes.

    Args:
        out: a folder that is empty or does not exist.
        workers: processes; 0: one per core.
        observe: called with each log once it is written.

    Returns:
        The path of the truth.

    Raises:
        MissingDependencyError: Open3D is not installed.
        UsageError: the folder is not empty, or is a file.
        WorkerDiedError: a worker was killed or crashed.
        OSError: a file cannot be written.
    """
    require_library("A simulation", "open3d")
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise UsageError(f"{out} exists already and is not an empty folder; give a new one for the fleet.")
    for vehicle in plan.build_seeds:
        (out / vehicle).mkdir(parents=True, exist_ok=True)
    originals = [log for log in plan.logs if not log.duplicate_of]
    with open_workers(workers, _MODULES) as pool:
        done = pool.map(_write_log, [(plan, log, out) for log in originals])
        for log, _ in zip(originals, done, strict=True):
            observe(log)
    for log in plan.logs:
        if log.duplicate_of:
            with (out / log.duplicate_of).open("rb") as original, atomic_file(out / log.path) as copy:
                shutil.copyfileobj(original, copy)
            observe(log)
    truth = out / TRUTH_NAME
    write_text_atomically(truth, fleet_truth_text(plan))
    return truth


def _write_log(_: Shared, task: tuple[FleetPlan, PlannedLog, Path]) -> None:
    plan, log, out = task
    path = out / log.path
    if log.fault in ("", "truncated"):
        _write_recording(plan, log, path)
    if log.fault:
        # A cut log ends within the first block of zstd (128 KiB unpacked): the reader takes what whole blocks hold.
        data = _CONTENTS[log.fault] if log.fault in _CONTENTS else path.read_bytes()
        with atomic_file(path) as file:
            file.write(data if log.fault in _CONTENTS else data[: min(len(data) // 2, 1 << 16)])


def _write_recording(plan: FleetPlan, log: PlannedLog, path: Path) -> None:
    simulation = simulate_snapshot(
        plan.rig,
        log.scene,
        log.seed,
        frames=plan.frames,
        disturbances=tuple(f"dead:{name}" for name in log.dead),
        build_seed=plan.build_seeds[log.vehicle],
        moved=log.moved,
        start_ns=log.time_ns,
    )
    snapshot, vehicle = thinned(simulation.snapshot, plan.keep_every), {"vehicle": log.vehicle}
    match log.format:
        case "snapshot":
            write_snapshot_mcap(snapshot, path, metadata={"frames": str(plan.frames), **vehicle})
        case "ros2_mcap":
            write_ros2_mcap(snapshot, path, metadata=vehicle)
        case "ros2_bag":
            write_ros2_bag(snapshot, path, custom_data=vehicle)
        case "ros1_bag":
            write_ros1_bag(snapshot, path)


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
    lists = []
    for key in ("logs", "events"):
        entries = ",\n".join(f"    {json.dumps(entry, allow_nan=False)}" for entry in truth[key])
        lists.append(f'  "{key}": [\n{entries}\n  ]')
    return "{\n" + ",\n".join(heads + lists) + "\n}\n"


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
        "T_target_lidar": {
            name: dict(zip(POSE_COLUMNS, (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist()), strict=True))
            for name, pose in plan.true_poses(log).items()
        },
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


def _iso(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).isoformat().replace("+00:00", "Z")
