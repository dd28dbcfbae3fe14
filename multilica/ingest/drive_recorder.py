# SPDX-License-Identifier: Apache-2.0
"""Recording of the stops of a drive from a running vehicle, with advice to the driver."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Literal

import numpy as np

from multilica.config import IngestConfig, StillnessConfig
from multilica.errors import InputError, UsageError, listed
from multilica.ingest.drive_reader import read_drive
from multilica.ingest.locate import PathLike, find_source
from multilica.ingest.recording import Span
from multilica.ingest.remote.address import ROS2, scheme_of
from multilica.ingest.snapshot_reader import TakenSnapshot, listen, live_address
from multilica.ingest.stops import MOST_STOPS, NEW_PLACE_M, offset_between
from multilica.ros2 import Ros2Node
from multilica.snapshot import LidarScans, Scan, Snapshot

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

_ONE_STOP = re.compile(r", stop \d+$")
_PAUSE_S = 0.5
_ENOUGH_TURN_DEG = 60.0
_BETWEEN_NS = 10**9
"""Log time between stops whose own times overlap."""
_DRIVE_ON = f"drive on by {NEW_PLACE_M:g} m or more, and turn by {_ENOUGH_TURN_DEG:g} degrees or more"


@dataclass(frozen=True, slots=True)
class StopAdvice:
    """A sentence that tells the driver what to do now; `recorded` counts the good stops."""

    recorded: int
    text: str


def take_stops(
    sources: Sequence[PathLike],
    wanted: int | Literal["auto"],
    save: Callable[[Snapshot, Sequence[Span]], None],
    tell: Callable[[StopAdvice], None],
    *,
    config: IngestConfig,
) -> TakenSnapshot:
    """Save the stops of a log, or record them from a running vehicle, as one snapshot.

    Args:
        sources: as for `take_snapshot`.
        save: called with the snapshot and the log times of its stops; from a vehicle, after each good stop.
        tell: called with advice to the driver.

    Raises:
        MultilicaError: as `read_drive` or `listen`.
        UsageError: a single frame per LiDAR is asked for from a vehicle.
    """
    address = live_address(sources)
    if not address:
        snapshot, spans = join_stops(read_drive(sources, wanted, config=config))
        save(snapshot, spans)
        return TakenSnapshot(snapshot, sum(file.stat().st_size for file in find_source(sources).files))
    if config.frames < 2:
        raise UsageError("Found --frames 1 with --stops; expected two or more: one frame does not tell if it stands.")
    with ExitStack() as opened:
        node = None
        if scheme_of(address) == ROS2:
            node = opened.enter_context(closing(Ros2Node(f"Recording from {address}")))
        look = partial(listen, address, config=config, node=node)
        number = MOST_STOPS if wanted == "auto" else wanted
        stops = record_stops(look, number, lambda each: save(*join_stops(each)), tell)
    return TakenSnapshot(join_stops(stops)[0])


def record_stops(
    look: Callable[[], TakenSnapshot],
    wanted: int,
    keep: Callable[[Sequence[Snapshot]], None],
    tell: Callable[[StopAdvice], None],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[Snapshot, ...]:
    """Take a snapshot at each of several stops of a running vehicle.

    A stop is good if the vehicle stands during a look, all LiDARs send, and it is away from the other stops.

    Args:
        look: takes a snapshot of the vehicle with two or more frames per LiDAR, as `listen`.
        keep: called with all stops so far after each good one, so that a recording that is broken off has them.
        tell: called after each look.

    Raises:
        InputError: the first look fails; later ones are told.
    """
    stops: list[Snapshot] = []
    turned_rad, before_s, is_heard = 0.0, clock(), False
    while len(stops) < wanted:
        try:
            taken = look()
        except InputError as failure:
            if not is_heard:
                raise
            tell(StopAdvice(len(stops), str(failure)))
            sleep(_PAUSE_S)
            continue
        now_s, is_heard = clock(), True
        rate_rad_s = _turn_rate_rad_s(taken.snapshot)
        if rate_rad_s is not None:
            turned_rad += rate_rad_s * (now_s - before_s)
            tell(StopAdvice(len(stops), f"The vehicle moves{_turned(turned_rad) if stops else ''}: stop for a moment."))
        elif taken.silent:
            text = f"no scan of {listed(sorted(taken.silent))}. Wait, or leave that out with --topic."
            tell(StopAdvice(len(stops), f"The vehicle stands, but there is {text}"))
        elif at := _number_of_place(stops, taken.snapshot):
            tell(StopAdvice(len(stops), f"The vehicle stands at stop {at}{_turned(turned_rad)}: {_DRIVE_ON}."))
        else:
            stops.append(taken.snapshot)
            keep(stops)
            tell(StopAdvice(len(stops), _praise(taken.snapshot, len(stops), wanted)))
            turned_rad = 0.0
        before_s = now_s
        if not stops or stops[-1] is not taken.snapshot:
            sleep(_PAUSE_S)
    return tuple(stops)


def join_stops(stops: Sequence[Snapshot]) -> tuple[Snapshot, tuple[Span, ...]]:
    """Return the frames of all stops as one snapshot, and the log times between which each of them lasts.

    Stops whose times overlap, as of point files without any, come one after the other.
    """
    stops = _one_after_the_other(stops)
    names = dict.fromkeys(name for stop in stops for name in stop.names)
    of_name = {lidar.name: lidar for stop in reversed(stops) for lidar in stop.lidars}
    lidars = tuple(
        replace(of_name[name], scans=tuple(scan for stop in stops if name in stop.names for scan in stop[name].scans))
        for name in names
    )
    notes = tuple(dict.fromkeys(note for stop in stops for note in stop.notes))
    source = _ONE_STOP.sub("", stops[0].source)
    return replace(stops[0], lidars=lidars, notes=notes, source=source), tuple(_span_ns(stop) for stop in stops)


def _one_after_the_other(stops: Sequence[Snapshot]) -> list[Snapshot]:
    found: list[Snapshot] = []
    for stop in stops:
        begin_ns, end_ns = _span_ns(stop)
        spans = [_span_ns(other) for other in found]
        overlaps = any(begin_ns <= last_ns and first_ns <= end_ns for first_ns, last_ns in spans)
        shift_ns = max(last_ns for _, last_ns in spans) + _BETWEEN_NS - begin_ns if overlaps else 0
        found.append(_later(stop, shift_ns))
    return found


def _later(stop: Snapshot, by_ns: int) -> Snapshot:
    """Return a stop with later log times, and with the same stamps."""
    return replace(
        stop,
        lidars=tuple(
            replace(
                lidar,
                scans=tuple(
                    replace(scan, log_time_ns=(scan.log_time_ns or scan.stamp_ns) + by_ns) for scan in lidar.scans
                ),
            )
            for lidar in stop.lidars
        ),
    )


def _span_ns(stop: Snapshot) -> Span:
    times_ns = [scan.log_time_ns or scan.stamp_ns for lidar in stop.lidars for scan in lidar.scans]
    return min(times_ns), max(times_ns)


def _turned(turned_rad: float) -> str:
    degrees = float(np.rad2deg(turned_rad))
    enough = ", which is enough" if degrees >= _ENOUGH_TURN_DEG else ""
    return f", after a turn of about {degrees:.0f} degrees{enough}"


def _praise(stop: Snapshot, number: int, wanted: int) -> str:
    scans = min(len(lidar.scans) for lidar in stop.lidars)
    good = f"Stop {number} of {wanted} is good: {len(stop.lidars)} LiDARs, {scans} scans each."
    return f"{good} That was the last one." if number == wanted else f"{good} Now {_DRIVE_ON}."


def _turn_rate_rad_s(snapshot: Snapshot) -> float | None:
    """Return how fast the vehicle turns, 0 where that is not seen; None if it stands."""
    from multilica.stages.stillness import detect_motion, explain_motion

    config = StillnessConfig()
    if not explain_motion({lidar.name: detect_motion(lidar.scans, config, track=False) for lidar in snapshot.lidars}):
        return None
    rates: list[float] = []
    for lidar in snapshot.lidars:
        first, second = lidar.scans[:2] if len(lidar.scans) > 1 else (lidar.scans[0],) * 2
        motion: Motion = detect_motion([first, second], config, track=False)
        if motion.observable and not motion.at_least and second.stamp_ns > first.stamp_ns:
            rates.append(motion.turn_rad * 1e9 / (second.stamp_ns - first.stamp_ns))
    return float(median(rates)) if rates else 0.0


def _number_of_place(stops: Sequence[Snapshot], now: Snapshot) -> int:
    """Return at which stop the vehicle stands, also if nothing shows that it does not; 0 for a new place."""
    for number, earlier in enumerate(stops, start=1):
        is_told, offset_m = offset_between(_first_scans(earlier), _first_scans(now))
        if not is_told or (offset_m is not None and offset_m < NEW_PLACE_M):
            return number
    return 0


def _first_scans(snapshot: Snapshot) -> Mapping[str, Scan]:
    from multilica.stages.stillness import whole_frames

    richest: Sequence[LidarScans] = sorted(snapshot.lidars, key=lambda lidar: (-lidar.points_count, lidar.name))[:2]
    return {lidar.name: lidar.scans[next(iter(whole_frames(lidar.scans)), 0)] for lidar in richest}
