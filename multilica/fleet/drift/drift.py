# SPDX-License-Identifier: Apache-2.0
"""LiDARs that moved on their vehicles, are elsewhere than their nominal pose, or are lost, over a fleet's logs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from multilica.errors import UsageError, listed
from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.changes import PoseChange, SeriesChanges, find_changes
from multilica.fleet.drift.dispersion import PRIOR_LOGS, calibrate_scatter, power_of, robust_scatter
from multilica.fleet.drift.findings import DriftEvent, FleetOffset, MovedPart, OffsetScope, Outage
from multilica.fleet.lidar_series import TO_LENGTHS, LidarSeries
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store
from multilica.geometry import FloatArray, RigidTransform, skew

FALSE_ALARM_RATE = 1e-3
"""Share of LiDARs that never moved and are reported: of a thousand LiDARs, one in all their logs."""
# A common motion fits worse in one of a thousand cases.
_LEAST_P_VALUE = 1e-3
# One of two explanations is ninety times likelier than the other.
_DECIDING = 9.0
_MIN_FLEET = 3
"""Smallest number of vehicles that can outvote one."""
_DEG = np.deg2rad(1.0)
# Brackets are bolted on within a few millimetres and a tenth of a degree: vehicles that differ by less are alike.
_ASSEMBLY = np.diag((np.array([0.1 * _DEG] * 3 + [0.003] * 3) * TO_LENGTHS) ** 2)
# Brackets of one batch share half of that, which the number of vehicles does not reduce.
_BATCH = _ASSEMBLY / 4.0
_T_DOF = 4.0
_ITERATIONS = 30
# One log without a pose is told by `fleet failures`; two in a row are no accident of the scene.
_OUTAGES = """
WITH states AS (
  SELECT vehicle, lidar, status = 'not_placed' AS lost, reason, key,
         epoch_ns(time) AS time_ns, row_number() OVER (PARTITION BY vehicle, lidar ORDER BY time, key) AS place,
         count(*) OVER (PARTITION BY vehicle, lidar) AS total
  FROM lidars WHERE time IS NOT NULL),
spells AS (
  SELECT *, place - row_number() OVER (PARTITION BY vehicle, lidar, lost ORDER BY place) AS spell FROM states)
SELECT vehicle, lidar, arg_max(reason, place) AS reason, arg_min(key, place) AS key, min(time_ns) AS time_ns,
       max(time_ns) AS last_time_ns, count(*) AS logs, max(place) = any_value(total) AS lasts
FROM spells WHERE lost GROUP BY vehicle, lidar, spell HAVING count(*) >= 2
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
    # The derivative (6, 6) of each LiDAR's offset by the motion of the target, along the target's axes.
    jacobians = {
        name: np.block([[-np.eye(3), np.zeros((3, 3))], [skew(each.xyz_m), -np.eye(3)]]) for name, each in seen.items()
    }
    for name, each in seen.items():
        weighted = np.linalg.solve(each.covariance, jacobians[name]).T
        normal += weighted @ jacobians[name]
        right += weighted @ each.offset
    common = np.asarray(np.linalg.solve(normal, right))
    if len(seen) < 2:
        return "lidar or target", common
    as_target = sum(_chi_squared(each, jacobians[name] @ common) for name, each in seen.items())
    as_lidars = sum(_chi_squared(each, np.zeros(6)) for name, each in seen.items() if name not in changed)
    if chdtrc(6 * (len(seen) - 1), as_target) < _LEAST_P_VALUE:
        return "lidar", common
    if len(changed) > 1 or as_target < as_lidars - _DECIDING:
        return "target", common
    return "lidar" if as_lidars < as_target - _DECIDING else "lidar or target", common


def _chi_squared(seen: _Seen, expected: FloatArray) -> float:
    left = seen.offset - expected
    return float(left @ np.linalg.solve(seen.covariance, left))


def find_outages(store: Store) -> list[Outage]:
    """Find the LiDARs that have no pose in several logs in a row, in the order of vehicles and LiDARs."""
    with ask(store, _OUTAGES) as answer:
        return [Outage(**dict(zip(answer.columns, row, strict=True))) for row in answer.rows()]


class _Mounted(NamedTuple):
    """The present pose of a LiDAR on its vehicle, as offset (6,) in metres from the reference."""

    vehicle: str
    offset_m: FloatArray
    covariance: FloatArray


def find_offsets(
    series: Sequence[LidarSeries], nominal: Extrinsics | None = None, false_alarm_rate: float = FALSE_ALARM_RATE
) -> list[FleetOffset]:
    """Find LiDARs away from their nominal pose on the whole fleet, and vehicles that differ from the fleet.

    A vehicle counts with the poses since its last jump. Vehicles may scatter by the tolerance of assembly, and by more
    if most do. Without a nominal pose of a LiDAR and its target, vehicles are compared with the fleet's median only.

    Args:
        series: of a whole fleet, at most one per vehicle, LiDAR and target.
        nominal: poses as designed.
        false_alarm_rate: share of the LiDARs of a fleet, and of the vehicles' LiDARs, reported though all are in place.

    Returns:
        In the order of LiDARs, the fleet's before the vehicles'.

    Raises:
        InputError: a joint of the nominal rig between a LiDAR and its target moves.
        UsageError: the nominal poses are of no LiDAR and its target.
    """
    designed = frozenset[str]() if nominal is None else nominal.members
    if nominal is not None and series and not any({each.lidar, each.target} <= designed for each in series):
        names = sorted({name for each in series for name in (each.lidar, each.target)})
        raise UsageError(
            f"The nominal poses are of {listed(sorted(designed))}; expected two or more LiDARs of the store, one of "
            f"them a target: {listed(names)}."
        )
    fleets: dict[tuple[str, str], list[_Mounted]] = defaultdict(list)
    references: dict[tuple[str, str], RigidTransform] = {}
    for poses in calibrate_scatter(series):
        each = poses.series
        pair = each.lidar, each.target
        if pair not in references:
            known = nominal.between(each.target, each.lidar) if nominal and {*pair} <= designed else None
            references[pair] = known or each.T_target_lidar[-1]
        changes = find_changes(poses, false_alarm_rate)
        newest, covariance = changes.fits.value(changes.periods[-1], float(changes.fits.time[-1]))
        own = each.T_target_lidar[len(each) // 2].offset_from(references[pair]) * TO_LENGTHS
        fleets[pair].append(_Mounted(each.vehicle, own + newest, covariance + poses.constant))
    return [
        offset
        for (lidar, target), mounted in sorted(fleets.items())
        for offset in _offsets(lidar, target, mounted, false_alarm_rate, has_nominal={lidar, target} <= designed)
    ]


def _offsets(
    lidar: str, target: str, mounted: list[_Mounted], false_alarm_rate: float, *, has_nominal: bool
) -> Iterator[FleetOffset]:
    count = len(mounted)

    def offset(scope: OffsetScope, vehicle: str | None, off_m: FloatArray, p_value: float) -> FleetOffset:
        parts = off_m / TO_LENGTHS
        return FleetOffset(
            lidar=lidar,
            target=target,
            scope=scope,
            vehicle=vehicle,
            vehicles=count,
            translation_m=parts[3:].tolist(),
            rotation_rad=parts[:3].tolist(),
            p_value=p_value,
        )

    offsets_m = np.array([each.offset_m for each in mounted])
    covariances = np.array([each.covariance for each in mounted]) + _ASSEMBLY
    few = count < _MIN_FLEET
    if few and not has_nominal:
        return
    center_m = np.zeros(6) if few else np.median(offsets_m, axis=0)
    to_unit = power_of(covariances, -0.5)
    whitened = np.einsum("nij,nj->ni", to_unit, offsets_m - center_m)
    excess = np.eye(6) if few else _at_least_one(robust_scatter(whitened))
    root = power_of(covariances, 0.5)
    covariances = root @ excess @ root
    dof = PRIOR_LOGS + (0 if few else count - 1)
    spread = np.zeros((6, 6))
    if not few:
        center_m, spread = _robust_mean(offsets_m, covariances, center_m)
    if has_nominal and not few:
        p_value = _p_value(center_m, spread + _BATCH, dof, 1)
        if p_value <= false_alarm_rate:
            yield offset("fleet", None, center_m, p_value)
    for each, covariance in zip(mounted, covariances, strict=True):
        off_m = each.offset_m - center_m
        p_value = _p_value(off_m, covariance + spread, dof, count)
        if p_value <= false_alarm_rate:
            yield offset("fleet or vehicle" if few else "vehicle", each.vehicle, off_m, p_value)


def _at_least_one(scatter: FloatArray) -> FloatArray:
    """Return a covariance (6, 6) that is at least the identity: the tolerance of assembly holds."""
    values, vectors = np.linalg.eigh(scatter)
    return np.asarray((vectors * np.maximum(values, 1.0)) @ vectors.T)


def _robust_mean(offsets_m: FloatArray, covariances: FloatArray, start_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean (6,) in which vehicles far off lose their weight, as in a t distribution, with its covariance."""
    inverse = np.linalg.inv(covariances)
    center_m, total = start_m, inverse.sum(axis=0)
    for _ in range(_ITERATIONS):
        left = offsets_m - center_m
        weights = (_T_DOF + 6.0) / (_T_DOF + np.einsum("ni,nij,nj->n", left, inverse, left))
        weights = np.minimum(1.0, weights)
        total = np.einsum("n,nij->ij", weights, inverse)
        center_m = np.linalg.solve(total, np.einsum("n,nij,nj->i", weights, inverse, offsets_m))
    return center_m, np.linalg.inv(total)


def _p_value(offset_m: FloatArray, covariance: FloatArray, dof: float, tests: int) -> float:
    squared = float(offset_m @ np.linalg.solve(covariance, offset_m))
    return min(1.0, tests * float(fdtrc(6, dof, squared / 6.0)))
