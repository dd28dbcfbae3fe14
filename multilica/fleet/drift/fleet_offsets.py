# SPDX-License-Identifier: Apache-2.0
"""LiDARs that are elsewhere than their nominal pose, in a whole fleet or on single vehicles."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f as f_distribution

from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.changes import find_changes
from multilica.fleet.drift.dispersion import PRIOR_LOGS, SHARED_COVARIANCE, calibrate_scatter, power_of, robust_scatter
from multilica.fleet.drift.drift import FALSE_ALARM_RATE
from multilica.fleet.drift.findings import FleetOffset, OffsetScope
from multilica.fleet.lidar_series import TO_LENGTHS, LidarSeries
from multilica.geometry import FloatArray, RigidTransform

_MIN_FLEET = 3
"""Smallest number of vehicles that can outvote one."""
_DEG = np.deg2rad(1.0)
# Brackets are bolted on within a few millimetres and a tenth of a degree: vehicles that differ by less are alike.
_ASSEMBLY = np.diag((np.array([0.1 * _DEG] * 3 + [0.003] * 3) * TO_LENGTHS) ** 2)
# Brackets of one batch share half of that, which the number of vehicles does not reduce.
_BATCH = _ASSEMBLY / 4.0
_T_DOF = 4.0
_ITERATIONS = 30


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
    """
    designed = frozenset[str]() if nominal is None else nominal.members
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
        fleets[pair].append(_Mounted(each.vehicle, own + newest, covariance + SHARED_COVARIANCE))
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
    excess = np.eye(6) if few else robust_scatter(whitened, 1.0)
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
    return min(1.0, tests * float(f_distribution.sf(squared / 6.0, 6, dof)))
