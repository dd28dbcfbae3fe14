# SPDX-License-Identifier: Apache-2.0
"""One rig out of the accepted pairs of several snapshots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.geometry import RigidTransform
from multilica.joint.disputes import Dispute, Edges, culprits, settle
from multilica.joint.estimate import Estimate, chained, estimate_poses
from multilica.joint.retell import shown_snapshot
from multilica.joint.snapshot_run import SnapshotRun
from multilica.joint.spread import scatter_ratio, spread_of, widened
from multilica.joint.target import choose_target
from multilica.results import (
    CalibrationResult,
    LidarPlacement,
    Refinement,
    SnapshotDeviation,
    SnapshotReport,
)
from multilica.stages.refine import RefinedRig, refine

__all__ = ["join"]


def join(runs: Sequence[SnapshotRun], config: CalibrationConfig | None = None) -> CalibrationResult:
    """Place every LiDAR of a rig by all snapshots that were taken of it.

    Snapshots that contradict each other are settled by majority first. Then one pose graph takes the registrations
    that all snapshots trust, each weighted with its information. Where the snapshots scatter more than their
    covariances predict, the covariance is widened to the scatter; it is never narrowed.

    Args:
        runs: calibrations of each snapshot by that configuration; refused ones have a refusal.
        config: the default preset if None.

    Returns:
        One placement per LiDAR that any snapshot has; `snapshots` holds what each contributed, `pairs` and `health`
        are those of the snapshot that `shown_snapshot` names.

    Raises:
        UnfitSnapshotError: every snapshot was refused.
        UnknownNameError: no snapshot has the LiDAR that is to be the target.
    """
    config = config or CalibrationConfig()
    results = {run.name: run.result for run in runs if run.result is not None}
    if not results:
        refusals = "; ".join(run.refusal.rstrip(".") for run in runs)
        raise UnfitSnapshotError(f"None of {len(runs)} snapshots can be used: {refusals}.")
    lidars = sorted({placement.lidar for result in results.values() for placement in result.placements})
    given: Edges = {name: result.trusted for name, result in results.items()}
    kept, disputes = settle(given, config)
    target, reason = choose_target(kept, lidars, config.target)
    joint = _Joint(
        target,
        results,
        kept,
        _rig(target, kept, config),
        _estimates(target, given, config),
        _estimates(target, kept, config),
        {name: culprits([each for each in disputes if each.snapshot == name], target) for name in results},
    )
    result = CalibrationResult(
        target=target,
        target_reason=reason,
        placements=tuple(joint.placement(name) for name in lidars),
        timing_s=dict(sum((Counter(result.timing_s) for result in results.values()), Counter())),
        refinement=joint.rig.refinement,
        snapshots=tuple(joint.report(run) for run in runs),
    )
    shown = results[shown_snapshot(result)]
    return replace(result, pairs=shown.pairs, health=shown.health)


def _rig(target: str, edges: Edges, config: CalibrationConfig) -> RefinedRig:
    told = [(name, edge) for name, own in edges.items() for edge in own if edge.information is not None]
    registrations = [edge for _, edge in told]
    poses = chained(target, registrations)
    rig = refine(target, poses, registrations, config.refine, [name for name, _ in told])
    used = [name for name, edge in told if {edge.target, edge.source} <= set(poses)]
    residuals = tuple(
        replace(residual, snapshot=name) for name, residual in zip(used, rig.refinement.edges, strict=False)
    )
    return replace(rig, refinement=Refinement(residuals))


def _estimates(target: str, edges: Edges, config: CalibrationConfig) -> dict[str, Mapping[str, Estimate]]:
    return {name: estimate_poses(target, own, config.refine) for name, own in edges.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """The joint rig beside what each snapshot says.

    Args:
        kept: per snapshot the registrations that contradict no other.
        alone: per snapshot and LiDAR the pose by that snapshot alone.
        agreed: the same without what contradicts other snapshots.
        blamed: per snapshot the LiDARs that it places otherwise than others, the first of each dispute.
    """

    target: str
    results: Mapping[str, CalibrationResult]
    kept: Edges
    rig: RefinedRig
    alone: Mapping[str, Mapping[str, Estimate]]
    agreed: Mapping[str, Mapping[str, Estimate]]
    blamed: Mapping[str, tuple[Dispute, ...]]

    def placement(self, lidar: str) -> LidarPlacement:
        if lidar == self.target:
            identity = RigidTransform.identity(lidar, lidar)
            return LidarPlacement(lidar, "the target", placed=True, T_target_source=identity, fitness=1.0, rmse_m=0.0)
        if lidar not in self.rig.covariances:
            return LidarPlacement(lidar, self._why_not_placed(lidar))
        estimates = [own[lidar] for own in self.agreed.values() if lidar in own]
        ratio = scatter_ratio(estimates)
        edges = [edge for own in self.kept.values() for edge in own if lidar in (edge.target, edge.source)]
        best = max(edges, key=lambda edge: edge.evidence)
        return LidarPlacement(
            lidar,
            f"placed by {len(estimates) or 'no single one'} of {len(self.results)} snapshots",
            placed=True,
            T_target_source=self.rig.poses[lidar],
            fitness=best.fitness,
            rmse_m=best.rmse_m,
            covariance=widened(self.rig.covariances[lidar], ratio),
            sigma_from="snapshots" if np.any(ratio > 1.0) else "residuals",
            spread=spread_of(estimates),
        )

    def _why_not_placed(self, lidar: str) -> str:
        disputes = [
            each for own in self.blamed.values() for each in own if each.lidars[0] == lidar and not each.outvoted
        ]
        if disputes:
            first = disputes[0]
            return (
                f"{first.snapshot} and {', '.join(first.others)} place it {first.distance_m:.3f} m and "
                f"{first.angle_deg:.2f} deg apart, seen from {first.lidars[1]}, and no majority of snapshots settles it"
            )
        reasons = (self._why_not_in(name, result, lidar) for name, result in self.results.items())
        return "; ".join(reason for reason in reasons if reason)

    def _why_not_in(self, snapshot: str, result: CalibrationResult, lidar: str) -> str:
        placement = next((each for each in result.placements if each.lidar == lidar), None)
        if placement is None:
            return ""
        if not placement.placed:
            return f"{snapshot}: {placement.reason}"
        blamed = ", ".join(dispute.lidars[0] for dispute in self.blamed[snapshot])
        if blamed:
            return f"{snapshot}: linked through what contradicts other snapshots on {blamed}"
        return f"{snapshot}: placed beside {result.target}, which nothing links to {self.target}"

    def report(self, run: SnapshotRun) -> SnapshotReport:
        deviations: dict[str, SnapshotDeviation] = {}
        for lidar, estimate in self.alone.get(run.name, {}).items():
            if lidar in self.rig.covariances:
                distance_m, angle_rad = estimate.pose.distance_to(self.rig.poses[lidar])
                deviations[lidar] = SnapshotDeviation(lidar, distance_m, float(np.rad2deg(angle_rad)))
        for dispute in self.blamed.get(run.name, ()):
            if dispute.outvoted:
                lidar = dispute.lidars[0]
                found = deviations.get(lidar, SnapshotDeviation(lidar, dispute.distance_m, dispute.angle_deg))
                deviations[lidar] = replace(found, outlier=True)
        return SnapshotReport(
            name=run.name,
            source=run.source,
            source_sha256=run.source_sha256,
            deviations=tuple(deviations[lidar] for lidar in sorted(deviations)),
            disputed=tuple(each.lidars[0] for each in self.blamed.get(run.name, ()) if not each.outvoted),
            refusal=run.refusal,
        )
