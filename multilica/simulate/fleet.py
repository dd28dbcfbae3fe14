# SPDX-License-Identifier: Apache-2.0
"""Plan of the logs of a fleet over a year, with known events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.errors import UsageError
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.simulation import true_extrinsics
from multilica.simulate.world import random_stream

EventKind = Literal["jump", "creep", "dead"]
LogFormat = Literal["snapshot", "ros2_mcap", "ros2_bag", "ros1_bag"]
LogFault = Literal["truncated", "zeros", "empty", "text", "lfs_pointer"]

_SUFFIXES: Mapping[LogFormat, str] = {"snapshot": ".mcap", "ros2_mcap": ".mcap", "ros2_bag": "", "ros1_bag": ".bag"}
_MCAP: tuple[LogFormat, ...] = ("snapshot", "ros2_mcap")
_IN_FAULT: Mapping[LogFault, tuple[LogFormat, ...]] = {
    "truncated": _MCAP,
    "zeros": (*_MCAP, "ros1_bag"),
    "empty": (*_MCAP, "ros1_bag"),
    "text": _MCAP,
    "lfs_pointer": (*_MCAP, "ros1_bag"),
}
"""Formats of broken logs. They are single files; a cut one is packed, or its beginning could be read."""

_RIG, _TARGET = "edgar", "left"
_MOVABLE = ("front", "rear")
"""Without an order, multilica takes the left or the right LiDAR of this rig as the target: neither has events."""
_SCENES = ("street", "parking", "garage")
_START_NS = 1_759_276_800_000_000_000
"""2025-10-01 in UTC."""
_DAY_NS, _DAYS = 86_400 * 10**9, 365
_USUAL_EVENTS: Mapping[EventKind, int] = {"jump": 3, "creep": 2, "dead": 1}
"""Vehicles with each event in a fleet of 20."""

_SIDE = 3
"""Logs on each side of a jump: fewer do not tell a motion from an outlier."""
_LEAST_LOGS: dict[EventKind, int] = {"jump": 2 * _SIDE, "creep": 2, "dead": 2}
"""Logs that a vehicle needs for an event."""
_SIZES = {"jump": ((0.03, 0.08), (0.3, 1.0)), "creep": ((0.002, 0.004), (0.01, 0.03))}
"""Least and largest shift (m) and turn (deg) of an event."""
_CREEP_PERIOD_NS = 30 * 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class PlannedEvent:
    """An event of one LiDAR.

    Args:
        first_log: index, among the vehicle's logs by time, of the first one after it.
        time_ns: when it happens; a creep continues from there.
        shift_m: (3,) along the axes of the LiDAR as built; of a creep, within 30 days.
        turn_rad: (3,) axis times angle about the same axes; of a creep, within 30 days.
    """

    vehicle: str
    lidar: str
    kind: EventKind
    first_log: int
    time_ns: int
    shift_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, ...] = (0.0, 0.0, 0.0)

    def moved(self, time_ns: int) -> RigidTransform | None:
        """Return the LiDAR's pose in its own frame as built at a time; None if it has not moved."""
        if self.kind == "dead" or time_ns < self.time_ns:
            return None
        share = (time_ns - self.time_ns) / _CREEP_PERIOD_NS if self.kind == "creep" else 1.0
        rotation = Rotation.from_rotvec(share * np.asarray(self.turn_rad)).as_matrix()
        shift_m = share * np.asarray(self.shift_m)
        return RigidTransform.from_rotation_translation(self.lidar, self.lidar, rotation, shift_m)

    def decisive(self, logs: int) -> frozenset[int]:
        """Return the indices of the logs that are needed to date the event."""
        if self.kind == "creep":
            return frozenset((0, logs - 1))
        return frozenset(range(max(0, self.first_log - _SIDE), min(logs, self.first_log + _SIDE)))


@dataclass(frozen=True, slots=True, eq=False)
class PlannedLog:
    """One log of a vehicle.

    Args:
        path: below the fleet's folder; ``<vehicle>/<date>_<number>`` with the suffix of the format.
        time_ns: of its first frames.
        fault: why it cannot be read; empty if it can.
        duplicate_of: path of the log with the same bytes; empty if it is the only one.
        moved: LiDARs that are no longer as built, as for `simulate_snapshot`.
        dead: LiDARs that return nothing.
    """

    path: str
    vehicle: str
    time_ns: int
    scene: str
    seed: int
    format: LogFormat
    fault: LogFault | Literal[""] = ""
    duplicate_of: str = ""
    moved: Mapping[str, RigidTransform] = field(default_factory=dict)
    dead: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FleetPlan:
    """The logs of a fleet, by vehicle, then time, its duplicates last; events, one per vehicle; seeds of the mountings.

    The target is never moved.
    """

    rig: str
    target: str
    frames: int
    keep_every: int
    build_seeds: Mapping[str, int]
    logs: tuple[PlannedLog, ...]
    events: tuple[PlannedEvent, ...]

    def logs_of(self, vehicle: str) -> tuple[PlannedLog, ...]:
        """Return the logs of a vehicle by time, without duplicates."""
        return tuple(log for log in self.logs if log.vehicle == vehicle and not log.duplicate_of)

    def true_poses(self, log: PlannedLog) -> dict[str, RigidTransform]:
        """Return the exact ``T_target_<lidar>`` of a log."""
        truth = true_extrinsics(self.rig, self.build_seeds[log.vehicle], log.moved)
        return {name: truth.between(self.target, name) for name in sorted(truth.T_target_source)}


def plan_fleet(
    vehicles: int = 20,
    logs: int = 200,
    seed: int = 0,
    *,
    frames: int = 2,
    keep_every: int = 12,
    jumps: int | None = None,
    creeps: int | None = None,
    dead: int | None = None,
    broken: int | None = None,
    duplicates: int | None = None,
) -> FleetPlan:
    """Plan a fleet; the same arguments give the same plan.

    Args:
        logs: of all vehicles, with the broken ones and the duplicates.
        frames: per LiDAR and log.
        keep_every: thinning of the returns; with 12, a log has 0.4 to 0.8 MB, and all its LiDARs can be placed.
        jumps: vehicles with a LiDAR that jumps; None: 3 of 20, if they have logs enough.
        creeps: vehicles with a LiDAR that creeps; None: 2 of 20.
        dead: vehicles with a LiDAR that dies; None: 1 of 20.
        broken: logs that cannot be read, not beside a jump; None: 5 %.
        duplicates: logs with the bytes of another one of the vehicle; None: 1 of 100, none in small fleets.

    Raises:
        UsageError: a negative number, or too few vehicles or logs for what is asked for.
    """
    usual = -(-logs // 100) if logs >= max(10, 2 * vehicles) else 0
    copies = usual if duplicates is None else duplicates
    faults = round(0.05 * logs) if broken is None else broken
    kept = logs - copies
    asked: dict[EventKind, int | None] = {"jump": jumps, "creep": creeps, "dead": dead}
    numbers = (faults, copies, seed, *(number or 0 for number in asked.values()))
    if vehicles < 1 or kept < vehicles or min(numbers) < 0 or min(frames, keep_every) < 1:
        raise UsageError(
            f"A fleet needs a vehicle or more, a log for each with a frame or more, and no negative number; found "
            f"{vehicles} vehicles, {logs} logs of {frames} frames, of these {copies} duplicates, {faults} broken logs "
            f"and seed {seed}."
        )
    width = max(2, len(str(vehicles)))
    names = [f"v{number:0{width}}" for number in range(1, vehicles + 1)]
    counts = {name: len(range(index, kept, vehicles)) for index, name in enumerate(names)}
    times_ns = {name: _times_ns(count, random_stream("fleet times", seed, name)) for name, count in counts.items()}
    events = _events(asked, times_ns, seed)
    own = {name: _logs(name, times_ns[name], events.get(name), seed) for name in names}
    planned = [log for logs_of in own.values() for log in logs_of]
    decisive = {own[name][index].path for name, event in events.items() for index in event.decisive(counts[name])}
    if broken is None:
        faults = min(faults, len(planned) - len(decisive))
    planned = _with_faults(planned, decisive, faults, seed)
    planned += _duplicates(planned, copies, seed)
    planned.sort(key=lambda log: (log.vehicle, bool(log.duplicate_of), log.time_ns))
    seeds = {name: int(random_stream("fleet mounting", seed, name).integers(10**6)) for name in names}
    found = tuple(events[name] for name in names if name in events)
    return FleetPlan(_RIG, _TARGET, frames, keep_every, seeds, tuple(planned), found)


def _times_ns(count: int, rng: np.random.Generator) -> list[int]:
    """Draw times by day, in whole seconds, with gaps of very different lengths between them."""
    gaps = rng.dirichlet(np.full(count + 1, 2.0))
    days = np.floor(np.cumsum(gaps)[:-1] * _DAYS).astype(int)
    seconds = np.sort(days * 86_400 + rng.integers(7 * 3600, 19 * 3600, size=count))
    distinct = np.maximum.accumulate(seconds - np.arange(count)) + np.arange(count)
    return [_START_NS + int(second) * 10**9 for second in distinct]


def _events(
    asked: Mapping[EventKind, int | None], times_ns: Mapping[str, Sequence[int]], seed: int
) -> dict[str, PlannedEvent]:
    """Draw the events, each of another vehicle that has logs enough."""
    rng = random_stream("fleet events", seed)
    free = [list(times_ns)[index] for index in rng.permutation(len(times_ns))]
    events: dict[str, PlannedEvent] = {}
    for kind, number in asked.items():
        fit = [name for name in free if len(times_ns[name]) >= _LEAST_LOGS[kind]]
        usual = -(-_USUAL_EVENTS[kind] * len(times_ns) // 20)
        chosen = fit[: usual if number is None else number]
        if number is not None and len(chosen) < number:
            raise UsageError(
                f"Found {len(fit)} vehicles for {number} events of the kind {kind}; expected a vehicle of its own for "
                f"each, with {_LEAST_LOGS[kind]} logs or more."
            )
        for name in chosen:
            events[name] = _draw_event(kind, name, times_ns[name], random_stream("fleet event", seed, name))
        free = [name for name in free if name not in chosen]
    return events


def _draw_event(kind: EventKind, vehicle: str, times_ns: Sequence[int], rng: np.random.Generator) -> PlannedEvent:
    """Draw an event of a vehicle with logs at these times, at least `_LEAST_LOGS` of them.

    A jump of 3 to 8 cm and 0.3 to 1 degree lies between two logs; a creep of 2 to 4 mm and 0.01 to 0.03 degrees within
    30 days begins with the first log; a dead LiDAR returns nothing from some log on.
    """
    lidar = _MOVABLE[int(rng.integers(len(_MOVABLE)))]
    first, time_ns = 0, times_ns[0]
    if kind != "creep":
        side = min(_SIDE, len(times_ns) // 2)
        first = int(rng.integers(side, len(times_ns) - side + 1))
        time_ns = (times_ns[first - 1] + times_ns[first]) // 2
    if kind == "dead":
        return PlannedEvent(vehicle, lidar, kind, first, time_ns)
    limits_m, limits_deg = _SIZES[kind]
    shift_m, turn_rad = _of_length(rng, *limits_m), _of_length(rng, *np.deg2rad(limits_deg))
    return PlannedEvent(vehicle, lidar, kind, first, time_ns, shift_m, turn_rad)


def _of_length(rng: np.random.Generator, least: float, most: float) -> tuple[float, ...]:
    """Return a vector (3,) of random direction with a length between two limits."""
    direction: FloatArray = rng.normal(size=3)
    return tuple((rng.uniform(least, most) * direction / np.linalg.norm(direction)).tolist())


def _logs(vehicle: str, times_ns: Sequence[int], event: PlannedEvent | None, seed: int) -> list[PlannedLog]:
    rng = random_stream("fleet logs", seed, vehicle)
    formats, logs = get_args(LogFormat), []
    order = np.concatenate([rng.permutation(len(formats)) for _ in times_ns])
    for index, time_ns in enumerate(times_ns):
        scene, kind = _SCENES[int(rng.integers(len(_SCENES)))], formats[order[index]]
        moved = event.moved(time_ns) if event else None
        is_dead = event is not None and event.kind == "dead" and index >= event.first_log
        log = PlannedLog(
            _path(vehicle, time_ns, index + 1, kind), vehicle, time_ns, scene, int(rng.integers(10**6)), kind
        )
        poses = {event.lidar: moved} if event and moved else {}
        logs.append(replace(log, moved=poses, dead=(event.lidar,) if event and is_dead else ()))
    return logs


def _path(vehicle: str, time_ns: int, number: int, kind: LogFormat) -> str:
    date = datetime.fromtimestamp(time_ns // 10**9, UTC)
    return f"{vehicle}/{date:%Y-%m-%d}_{number:02}{_SUFFIXES[kind]}"


def _with_faults(logs: Sequence[PlannedLog], spared: set[str], number: int, seed: int) -> list[PlannedLog]:
    """Break this many logs, with each fault in turn."""
    rng, faults = random_stream("fleet faults", seed), get_args(LogFault)
    chosen = _chosen([log.path for log in logs if log.path not in spared], number, "broken logs", rng)
    broken = []
    for log in logs:
        if log.path not in chosen:
            broken.append(log)
            continue
        fault = faults[chosen.index(log.path) % len(faults)]
        kind = _IN_FAULT[fault][int(rng.integers(len(_IN_FAULT[fault])))]
        stem = log.path.removesuffix(_SUFFIXES[log.format])
        broken.append(replace(log, path=stem + _SUFFIXES[kind], format=kind, fault=fault))
    return broken


def _duplicates(logs: Sequence[PlannedLog], number: int, seed: int) -> list[PlannedLog]:
    """Copy this many logs that are files, each under the next number of its vehicle."""
    rng = random_stream("fleet duplicates", seed)
    originals = {log.path: log for log in logs if not log.fault and _SUFFIXES[log.format]}
    copies: list[PlannedLog] = []
    for path in _chosen(list(originals), number, "duplicates", rng):
        log = originals[path]
        count = sum(each.vehicle == log.vehicle for each in (*logs, *copies))
        copies.append(replace(log, path=_path(log.vehicle, log.time_ns, count + 1, log.format), duplicate_of=log.path))
    return copies


def _chosen(paths: Sequence[str], number: int, what: str, rng: np.random.Generator) -> list[str]:
    if number > len(paths):
        raise UsageError(f"Found {len(paths)} logs that may become {what}; expected {number}.")
    return [paths[index] for index in rng.permutation(len(paths))[:number]]
