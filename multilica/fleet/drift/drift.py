# SPDX-License-Identifier: Apache-2.0
"""LiDARs that moved on their vehicles, by a jump or a creep, or are lost, over the logs of a fleet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from multilica.errors import UsageError
from multilica.fleet.drift.changes import PoseChange, SeriesChanges, find_changes
from multilica.fleet.drift.dispersion import calibrate_scatter
from multilica.fleet.drift.findings import DriftEvent, MovedPart, Outage
from multilica.fleet.lidar_series import LidarSeries
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store
from multilica.geometry import FloatArray, skew

FALSE_ALARM_RATE = 1e-3
"""Share of LiDARs that never moved and are reported: of a thousand LiDARs, one in all their logs."""
# A common motion fits worse in one of a thousand cases.
_LEAST_P_VALUE = 1e-3
# One of two explanations is ninety times likelier than the other.
_DECIDING = 9.0
# One log without a pose is told by `fleet failures`; two in a row are no accident of the scene.
_OUTAGES = """
WITH states AS (
  SELECT vehicle, lidar, CASE WHEN status = 'not_placed' THEN reason ELSE '' END AS lost, key,
         epoch_ns(time) AS time_ns, row_number() OVER (PARTITION BY vehicle, lidar ORDER BY time, key) AS place,
         count(*) OVER (PARTITION BY vehicle, lidar) AS total
  FROM lidars WHERE time IS NOT NULL),
spells AS (
  SELECT *, place - row_number() OVER (PARTITION BY vehicle, lidar, lost ORDER BY place) AS spell FROM states)
SELECT vehicle, lidar, lost AS reason, arg_min(key, place) AS key, min(time_ns) AS time_ns,
       max(time_ns) AS last_time_ns, count(*) AS logs, max(place) = any_value(total) AS lasts
FROM spells WHERE lost <> '' GROUP BY vehicle, lidar, lost, spell HAVING count(*) >= 2
ORDER BY vehicle, lidar, min(place)
"""


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
    for poses in calibrate_scatter(series):
        each = poses.series
        if each.lidar in rigs[each.vehicle, each.target]:
            raise ValueError(f"two series of {each.lidar} of {each.vehicle}")
        rigs[each.vehicle, each.target][each.lidar] = find_changes(poses, false_alarm_rate)
    events = [event for rig in rigs.values() for event in _rig_events(rig)]
    return sorted(events, key=lambda event: (event.vehicle, event.time_ns, event.lidars, event.kind))


def _rig_events(rig: dict[str, SeriesChanges]) -> Iterator[DriftEvent]:
    for kind in ("jump", "creep"):
        found = [change for changes in rig.values() for change in changes.changes if change.kind == kind]
        for together in _simultaneous(found):
            yield from _events(together, rig)


def _simultaneous(found: list[PoseChange]) -> list[list[PoseChange]]:
    """Group the changes of different LiDARs at one time, the clearest of a group first."""
    groups: list[list[PoseChange]] = []
    for each in sorted(found, key=lambda one: (one.p_value, -one.squared, one.series.lidar)):
        for group in groups:
            if all(each.series.lidar != other.series.lidar for other in group) and _coincide(each, group[0]):
                group.append(each)
                break
        else:
            groups.append([each])
    return groups


def _coincide(one: PoseChange, other: PoseChange) -> bool:
    """Decide whether two creeps overlap by half, or two jumps are at most one log apart, as noise may date them."""
    common_ns = min(one.end_ns, other.end_ns) - max(one.start_ns, other.start_ns)
    if one.kind == "creep":
        return common_ns > 0.5 * max(one.end_ns - one.start_ns, other.end_ns - other.start_ns)
    return common_ns >= 0


def _events(together: list[PoseChange], rig: dict[str, SeriesChanges]) -> Iterator[DriftEvent]:
    """Yield one event if the target moved, else one per LiDAR; the clearest change comes first."""
    clearest = together[0]
    own_changes = {each.series.lidar: each for each in together}
    seen = {}
    for name, changes in rig.items():
        offset = (
            changes.step_at(own_changes.get(name, clearest).end_ns)
            if clearest.kind == "jump"
            else changes.motion_between(clearest.start_ns, clearest.end_ns)
        )
        if offset is not None:
            middle = changes.poses.series.T_target_lidar[len(changes.poses.series) // 2]
            seen[name] = _Seen(middle.xyz_m, *offset)
    moved, target_offset = _find_moved_part(seen, own_changes)
    if moved == "target":
        yield _event(clearest, tuple(sorted(own_changes)), "target", target_offset)
        return
    for each in together:
        yield _event(each, (each.series.lidar,), moved, each.offset)


def _event(change: PoseChange, lidars: tuple[str, ...], moved: MovedPart, offset: FloatArray) -> DriftEvent:
    series = change.series
    return DriftEvent(
        vehicle=series.vehicle,
        lidars=lidars,
        target=series.target,
        kind=change.kind,
        moved=moved,
        key=series.keys[change.index],
        time_ns=int(series.time_ns[change.index]),
        last_before_key=series.keys[change.before],
        last_before_time_ns=change.start_ns,
        last_key=series.keys[change.end],
        last_time_ns=change.end_ns,
        translation_m=offset[3:].tolist(),
        rotation_rad=offset[:3].tolist(),
        p_value=change.p_value,
    )


class _Seen(NamedTuple):
    """A LiDAR's position (3,), and its offset (6,) along the target's axes (rotation rad, translation m)."""

    xyz_m: FloatArray
    offset: FloatArray
    covariance: FloatArray


def _find_moved_part(seen: Mapping[str, _Seen], changed: Collection[str]) -> tuple[MovedPart, FloatArray]:
    """Decide between the LiDARs that changed significantly and the target.

    If the target moves by D, each ``T_target_lidar`` becomes ``D^-1 T_target_lidar``: one motion of six numbers has to
    explain all LiDARs, also those whose own change is not significant. The covariances are taken as independent.

    Args:
        seen: every LiDAR of the vehicle with logs before and after.
        changed: those that changed significantly.

    Returns:
        The part that moved, and the target's motion (6,) along its own axes before it, as of a LiDAR.
    """
    normal, right = np.zeros((6, 6)), np.zeros(6)
    jacobians = {name: _by_target(each.xyz_m) for name, each in seen.items()}
    for name, each in seen.items():
        weighted = np.linalg.solve(each.covariance, jacobians[name]).T
        normal += weighted @ jacobians[name]
        right += weighted @ each.offset
    common = np.asarray(np.linalg.solve(normal, right))
    if len(seen) < 2:
        return "lidar or target", common
    as_target = sum(_chi_squared(each, jacobians[name] @ common) for name, each in seen.items())
    as_lidars = sum(_chi_squared(each, np.zeros(6)) for name, each in seen.items() if name not in changed)
    if chi2.sf(as_target, 6 * (len(seen) - 1)) < _LEAST_P_VALUE:
        return "lidar", common
    if len(changed) > 1 or as_target < as_lidars - _DECIDING:
        return "target", common
    return "lidar" if as_lidars < as_target - _DECIDING else "lidar or target", common


def _by_target(xyz_m: FloatArray) -> FloatArray:
    """Return the derivative (6, 6) of a LiDAR's offset by the motion of the target along the target's axes."""
    return np.block([[-np.eye(3), np.zeros((3, 3))], [skew(xyz_m), -np.eye(3)]])


def _chi_squared(seen: _Seen, expected: FloatArray) -> float:
    left = seen.offset - expected
    return float(left @ np.linalg.solve(seen.covariance, left))


def find_outages(store: Store) -> list[Outage]:
    """Find the LiDARs that have no pose in several logs in a row, in the order of vehicles and LiDARs."""
    with ask(store, _OUTAGES) as answer:
        return [Outage(**dict(zip(answer.columns, row, strict=True))) for row in answer.rows()]
