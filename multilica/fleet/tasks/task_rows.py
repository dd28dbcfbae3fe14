# SPDX-License-Identifier: Apache-2.0
"""The rows of `lidars` that a log gives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from multilica.checks import check_found, relative_covariance
from multilica.diagnosis import explain
from multilica.diagnosis.explanation import Missing, Uncertain
from multilica.extrinsics import Extrinsics
from multilica.fleet.store.records import LidarRow
from multilica.fleet.tasks.log_task import LogTask
from multilica.geometry import FloatArray, RigidTransform
from multilica.results.document import ResultDocument
from multilica.snapshot import Snapshot
from multilica.verification import register_from_known


def verified_rows(request: LogTask, snapshot: Snapshot, known: Extrinsics) -> list[LidarRow]:
    """Return the poses near the known ones, relative to their target; none unless all LiDARs are where they were."""
    found = register_from_known(snapshot, known, request.config)
    if known.target not in found.poses or check_found(found, snapshot, known, request.tolerances).verdict != "within":
        return []
    target, T_target_root = found[known.target], found.poses[known.target].inverse()
    rows = []
    for name in snapshot.names:
        covariance = None if name == known.target else relative_covariance(target, found[name], found.target)
        pose = T_target_root @ found.poses[name]
        rows.append(_row(request, name, known.target, "verified", "placed", pose, covariance))
    return rows


def calibrated_rows(request: LogTask, document: ResultDocument) -> list[LidarRow]:
    """Return the poses of a calibration, and why LiDARs have none or an uncertain one."""
    outcome = explain(document)
    causes: dict[str, Missing | Uncertain] = {each.lidar: each for each in outcome.missing}
    causes |= {each.lidar: each for each in outcome.uncertain}
    evidence: dict[str, float] = {}
    for pair in document.pairs:
        for name in (pair.target, pair.source) if pair.verdict.accepted else ():
            evidence[name] = max(evidence.get(name, 0.0), pair.evidence)
    rows = []
    for name, entry in document.lidars.items():
        pose = entry.T_target_source
        cause = causes.get(name)
        rows.append(
            _row(
                request,
                name,
                document.target,
                "calibrated",
                entry.status,
                None if pose is None else RigidTransform(document.target, name, np.asarray(pose)),
                None if entry.covariance is None or name == document.target else np.asarray(entry.covariance),
                reason="" if cause is None else cause.cause,
                reason_text="" if cause is None else cause.headline,
                evidence=evidence.get(name),
            )
        )
    return rows


def _row(
    request: LogTask,
    lidar: str,
    target: str,
    how: Literal["verified", "calibrated"],
    status: Literal["placed", "uncertain", "not_placed"],
    pose: RigidTransform | None,
    covariance: FloatArray | None,
    **more: Any,  # noqa: ANN401 - fields of the row
) -> LidarRow:
    row = LidarRow(request.key, request.time_ns, request.source, lidar, target, how, status, **more)
    if pose is not None:
        x_m, y_m, z_m = pose.xyz_m.tolist()
        qx, qy, qz, qw = pose.quaternion_xyzw.tolist()
        row = replace(row, x_m=x_m, y_m=y_m, z_m=z_m, qx=qx, qy=qy, qz=qz, qw=qw)
    if covariance is not None:
        sigma_rad, sigma_m = (
            float(np.sqrt(max(np.linalg.eigvalsh(block)[-1], 0.0)))
            for block in (covariance[:3, :3], covariance[3:, 3:])
        )
        row = replace(
            row,
            covariance=tuple(covariance.ravel().tolist()),
            sigma_mm=1000.0 * sigma_m,
            sigma_deg=float(np.rad2deg(sigma_rad)),
        )
    return row
