# SPDX-License-Identifier: Apache-2.0
"""LiDARs that moved on their vehicles, by a jump or a creep, over the logs of a fleet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from multilica.errors import UsageError
from multilica.fleet.drift.changes import ChangeKind, PoseChange, SeriesChanges, find_changes
from multilica.fleet.drift.dispersion import calibrate_scatter
from multilica.fleet.drift.lidar_series import LidarSeries
from multilica.fleet.drift.moved_part import MovedPart, Seen, find_moved_part
from multilica.geometry import FloatArray, read_only

FALSE_ALARM_RATE = 1e-3
"""Share of LiDARs that never moved and are reported: of a thousand LiDARs, one in all their logs."""

_NS_PER_DAY = 86_400_000_000_000
_RATE_DAYS = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftEvent:
    """A LiDAR, or the target of a vehicle's LiDARs, that moved.

    Args:
        lidars: whose poses changed significantly, in name order; of one LiDAR that moved, itself.
        moved: the LiDAR, the target, or one of the two where no other LiDAR beside the target tells them apart.
        key, time_ns: of the first log after a jump, or of the first log until which a creep has moved the LiDAR by more
            than one sigma of that log's own pose.
        last_before_key, last_before_time_ns: of the last log before a jump, or of the first log of a creep.
        last_key, last_time_ns: of the last log of a creep; `key` and `time_ns` for a jump.
        translation_m, rotation_rad: (3,) motion of the LiDAR, or of the target, along the target's axes; of a creep
            from its first log to its last.
        p_value: share of LiDARs that never moved and seem to as clearly.
    """

    vehicle: str
    target: str
    lidars: tuple[str, ...]
    kind: ChangeKind
    moved: MovedPart
    key: str
    time_ns: int
    last_before_key: str
    last_before_time_ns: int
    last_key: str
    last_time_ns: int
    translation_m: FloatArray
    rotation_rad: FloatArray
    p_value: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "translation_m", read_only(self.translation_m, np.float64))
        object.__setattr__(self, "rotation_rad", read_only(self.rotation_rad, np.float64))

    @property
    def per_30_days(self) -> tuple[FloatArray, FloatArray] | None:
        """The rate of a creep, translation (m) and rotation (rad), (3,) each; None for a jump."""
        if self.kind == "jump":
            return None
        share = _RATE_DAYS * _NS_PER_DAY / (self.last_time_ns - self.last_before_time_ns)
        return self.translation_m * share, self.rotation_rad * share

    @property
    def what(self) -> str:
        """The moved part, for people."""
        if self.moved == "target":
            return f"the target {self.target}"
        return f"{self.lidars[0]} or the target {self.target}" if self.moved == "lidar or target" else self.lidars[0]

    @property
    def sentence(self) -> str:
        """The event in one sentence, for people; dates are UTC."""
        if (rate := self.per_30_days) is not None:
            since = _date(self.last_before_time_ns, self.time_ns)
            return f"{self.vehicle}: {self.what} creeps by {describe_motion(*rate)} per 30 days since {since}."
        first = _date(self.last_before_time_ns, self.time_ns)
        then = _date(self.time_ns, self.last_before_time_ns)
        motion = describe_motion(self.translation_m, self.rotation_rad)
        return f"{self.vehicle}: {self.what} moved by {motion} between {first} and {then}."


def describe_motion(translation_m: FloatArray, rotation_rad: FloatArray) -> str:
    """Return the lengths of a translation and of a rotation, for people."""
    length_mm, angle_deg = 1e3 * float(np.linalg.norm(translation_m)), float(np.rad2deg(np.linalg.norm(rotation_rad)))
    return f"{length_mm:.{0 if length_mm >= 10.0 else 1}f} mm and {angle_deg:.2f} deg"


def find_drift(series: Sequence[LidarSeries], false_alarm_rate: float = FALSE_ALARM_RATE) -> list[DriftEvent]:
    """Find the LiDARs that moved, in the order of vehicles and times.

    A jump needs two logs before and two after it: until a second log confirms it, it is not told from one bad pose.
    The vehicles of a fleet belong into one call, since the scatter of the poses is estimated over all of them.

    Args:
        series: of any number of vehicles, at most one per vehicle, LiDAR and target.
        false_alarm_rate: share of LiDARs that never moved and are reported.

    Raises:
        UsageError: the rate is not between 0 and 0.5.
        ValueError: two series of one LiDAR of a vehicle.
    """
    if not 0.0 < false_alarm_rate < 0.5:
        raise UsageError(f"The false-alarm rate is {false_alarm_rate:g}; expected a number above 0 and below 0.5.")
    rigs: dict[tuple[str, str], dict[str, SeriesChanges]] = defaultdict(dict)
    for poses in calibrate_scatter([each for each in series if len(each)]):
        each = poses.series
        if each.lidar in rigs[each.vehicle, each.target]:
            raise ValueError(f"two series of {each.lidar} of {each.vehicle}")
        rigs[each.vehicle, each.target][each.lidar] = find_changes(poses, false_alarm_rate)
    events = [event for rig in rigs.values() for event in _rig_events(rig)]
    return sorted(events, key=lambda event: (event.vehicle, event.time_ns, event.lidars, event.kind))


@dataclass(frozen=True, slots=True, eq=False)
class _LidarChange:
    """A change with its LiDAR and the times of its first and last log."""

    lidar: str
    change: PoseChange
    start_ns: int
    end_ns: int


def _rig_events(rig: dict[str, SeriesChanges]) -> Iterator[DriftEvent]:
    for kind in ("jump", "creep"):
        found = [
            _LidarChange(lidar, change, int(times_ns[change.before]), int(times_ns[change.end]))
            for lidar in sorted(rig)
            for times_ns in [rig[lidar].poses.series.time_ns]
            for change in rig[lidar].changes
            if change.kind == kind
        ]
        for together in _simultaneous(found):
            yield from _events(together, rig)


def _simultaneous(found: list[_LidarChange]) -> list[list[_LidarChange]]:
    """Group the changes of different LiDARs at one time, the clearest of a group first."""
    groups: list[list[_LidarChange]] = []
    for each in sorted(found, key=lambda one: (one.change.p_value, -one.change.squared, one.lidar)):
        for group in groups:
            if all(each.lidar != other.lidar for other in group) and _coincide(each, group[0]):
                group.append(each)
                break
        else:
            groups.append([each])
    return groups


def _coincide(one: _LidarChange, other: _LidarChange) -> bool:
    """Decide whether two creeps overlap by half, or two jumps are at most one log apart, as noise may date them."""
    common_ns = min(one.end_ns, other.end_ns) - max(one.start_ns, other.start_ns)
    if one.change.kind == "creep":
        return common_ns > 0.5 * max(one.end_ns - one.start_ns, other.end_ns - other.start_ns)
    return common_ns >= 0


def _events(together: list[_LidarChange], rig: dict[str, SeriesChanges]) -> Iterator[DriftEvent]:
    """Yield one event if the target moved, else one per LiDAR; the clearest change comes first."""
    clearest = together[0]
    seen = {}
    for name, changes in rig.items():
        own = next((each for each in together if each.lidar == name), clearest)
        offset = (
            changes.step_at(own.end_ns)
            if own.change.kind == "jump"
            else changes.motion_between(clearest.start_ns, clearest.end_ns)
        )
        if offset is not None:
            middle = changes.poses.series.T_target_lidar[len(changes.poses.series) // 2]
            seen[name] = Seen(middle.xyz_m, *offset)
    verdict = find_moved_part(seen, {each.lidar for each in together})
    if verdict.moved == "target":
        names = tuple(sorted(each.lidar for each in together))
        yield _event(clearest, rig, names, "target", verdict.target_offset)
        return
    for each in together:
        yield _event(each, rig, (each.lidar,), verdict.moved, each.change.offset)


def _event(
    found: _LidarChange, rig: dict[str, SeriesChanges], lidars: tuple[str, ...], moved: MovedPart, offset: FloatArray
) -> DriftEvent:
    series, change = rig[found.lidar].poses.series, found.change
    return DriftEvent(
        series.vehicle,
        series.target,
        lidars,
        change.kind,
        moved,
        series.keys[change.index],
        int(series.time_ns[change.index]),
        series.keys[change.before],
        found.start_ns,
        series.keys[change.end],
        found.end_ns,
        offset[3:],
        offset[:3],
        change.p_value,
    )


def _date(time_ns: int, other_ns: int) -> str:
    """Return the day of a time, with the time of day if the other time is on the same day."""
    one, other = (datetime.fromtimestamp(each / 1e9, UTC) for each in (time_ns, other_ns))
    return f"{one:%Y-%m-%d %H:%M}" if one.date() == other.date() else f"{one:%Y-%m-%d}"
