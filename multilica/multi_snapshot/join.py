# SPDX-License-Identifier: Apache-2.0
"""Joint result of several snapshots of one rig."""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import fsum
from types import MappingProxyType

import numpy as np

from multilica.acceptance.placement import contested_place, place, place_target, why_unplaced_jointly
from multilica.config import STAGES, AcceptanceConfig, CalibrationConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.geometry import RigidTransform
from multilica.multi_snapshot.cycle_doubts import doubts_within, widened_by_doubts
from multilica.multi_snapshot.estimate import Estimate, chance_of_difference, estimate_poses, scatter_ratio, spread_of
from multilica.multi_snapshot.knocks import MOST_M, MOST_RAD
from multilica.multi_snapshot.motions import ToldPose
from multilica.multi_snapshot.pose_conflicts import (
    LeadAt,
    SnapshotPairs,
    excluded_poses,
    inconsistent_lidars,
    resolve_conflicts,
    without_conflicts,
)
from multilica.multi_snapshot.replay import shown_snapshot
from multilica.multi_snapshot.snapshot_run import SnapshotRun, only_refused
from multilica.multi_snapshot.trusted_links import ContradictionAt, LinkedRig, refine_linked
from multilica.results import (
    CalibrationResult,
    DriveView,
    LidarPlacement,
    PairRegistration,
    PairResidual,
    PoseConflict,
    Refinement,
    SnapshotDeviation,
    SnapshotReport,
    StopPose,
    TimeLimit,
    ViewPair,
)
from multilica.results.placements import LEAST_PROBABILITY
from multilica.results.values import ONLY_GROUND, ONLY_MOTION
from multilica.stages.refine import RefinedRig


def require_joinable(config: CalibrationConfig) -> None:
    """Check that calibrations with this configuration can be joined.

    Raises:
        UsageError: they stop too early, or do not compute the covariance of a pair.
    """
    if STAGES.index(config.until) < STAGES.index("refine"):
        raise UsageError(
            f"Found several snapshots with --until {config.until}; "
            "a joint result needs the stages up to refine: leave --until out, or give one snapshot."
        )
    if not config.refine.enabled or config.fine.engine != "small_gicp":
        raise UsageError(
            f"Found several snapshots with refine.enabled={str(config.refine.enabled).lower()} and "
            f"fine.engine={config.fine.engine} (preset {config.preset}); a joint result weighs pairs by the "
            "information from refinement with small_gicp: use both, or give one snapshot."
        )


def join(
    runs: Sequence[SnapshotRun],
    config: CalibrationConfig | None = None,
    links: Sequence[ViewPair] = (),
    contradiction_at: ContradictionAt | None = None,
    lead_at: LeadAt | None = None,
    motions: Sequence[ViewPair] = (),
    levels: Mapping[str, RigidTransform] = MappingProxyType({}),
) -> CalibrationResult:
    """Place every LiDAR of a rig from all its snapshots.

    Contradictions between snapshots are resolved by majority first. Then one pose graph takes the trusted registrations
    of all snapshots, each weighted with its information. If the snapshots scatter more than their covariances
    predict, the covariance is widened to the scatter; it is never narrowed.

    Args:
        runs: each snapshot calibrated with that configuration, or its refusal.
        config: the default preset if None.
        links: registrations between snapshots that are stops of one drive.
        contradiction_at: tests poses at the stops that do not tell them; None: they are not tested.
        lead_at: compares poses of stops at those that left a pair undecided; None: they are not compared.
        motions: of LiDARs between these snapshots, by odometry.
        levels: poses of LiDARs over the ground, of use where pairs and links leave a pose open.

    Returns:
        One placement per LiDAR of any snapshot; `snapshots` has the contribution of each. `pairs` and `health` are
        those of the snapshot that `shown_snapshot` names.

    Raises:
        UnfitSnapshotError: every snapshot was refused.
        UnknownNameError: no snapshot has the LiDAR that `config.target` names.
    """
    config = config or CalibrationConfig()
    results = {run.name: run.result for run in runs if run.result is not None}
    if not results:
        refusals = "; ".join(run.refusal.rstrip(".") for run in runs)
        raise UnfitSnapshotError(f"None of {len(runs)} snapshots can be used: {refusals}.")
    lidars = sorted({placement.lidar for result in results.values() for placement in result.placements})
    given: SnapshotPairs = {name: result.trusted for name, result in results.items()}
    excluded = () if lead_at is None else excluded_poses(given, results, lead_at, config)
    kept, conflicts = resolve_conflicts(without_conflicts(given, excluded), config)
    conflicts = (*excluded, *conflicts)
    target, reason = choose_target(kept, lidars, config.target, links)
    inconsistent = {
        name: inconsistent_lidars([each for each in conflicts if each.snapshot == name], target) for name in results
    }
    moved = [DriveView(conflict.lidars[0], name) for name, own in inconsistent.items() for conflict in own]
    alike = any(each.distance_m > MOST_M or each.angle_deg > np.rad2deg(MOST_RAD) for each in conflicts)
    linked = _rig(
        refine_linked(
            target,
            kept,
            links,
            config.refine,
            contradiction_at,
            moved,
            looks_alike=alike,
            motions=motions,
            levels=levels,
            max_baseline_m=config.acceptance.max_baseline_m,
        ),
    )
    if linked.conflicts or linked.knocks:
        left = {id(pair.registration) for pair in linked.within}
        kept = {name: tuple(each for each in own if id(each) in left) for name, own in kept.items()}
    alone = _estimates(target, given, config)
    changed = {name: own for name, own in kept.items() if own is not given[name]}
    joint = _JointRig(
        target,
        results,
        kept,
        linked,
        alone,
        alone | _estimates(target, changed, config),
        inconsistent,
        {name: doubts_within(target, kept[name], result) for name, result in results.items()},
        config.acceptance,
    )
    result = CalibrationResult(
        target=target,
        target_reason=reason,
        placements=tuple(joint.placement(name) for name in lidars),
        timing_s=dict(sum((Counter(result.timing_s) for result in results.values()), Counter())),
        refinement=joint.rig.refinement,
        stops=joint.stops(),
        links=joint.linked.links,
        knocks=joint.linked.knocks,
        motions=joint.linked.motions,
        time_limit=_time_limit(results.values(), joint.rig.poses),
        snapshots=tuple(joint.report(run) for run in runs),
    )
    shown = results[shown_snapshot(result)]
    placements = tuple(
        each
        if each.T_target_source is not None
        else replace(each, contested=contested_place(each.lidar, result.poses, shown.pairs))
        for each in result.placements
    )
    every = sorted((*placements, *only_refused(runs, lidars)), key=lambda placement: placement.lidar)
    return replace(result, placements=tuple(every), pairs=shown.pairs, health=shown.health)


def choose_target(
    pairs: SnapshotPairs, lidars: Sequence[str], asked_for: str, links: Sequence[ViewPair] = ()
) -> tuple[str, str]:
    """Choose the LiDAR that the user names, else the one with the most overlap in the most snapshots.

    Args:
        pairs: of at least one snapshot, without contradicting ones, so that the target is not disputed.
        lidars: all names, in order.
        asked_for: empty if the user names none.
        links: decide where no snapshot has a pair.

    Returns:
        The name of the target and the reason in words.

    Raises:
        UnknownNameError: no snapshot has the LiDAR that the user names.
    """
    if asked_for:
        if asked_for not in lidars:
            raise UnknownNameError("LiDAR", asked_for, lidars)
        return asked_for, "set by --target"
    overlaps = [_overlap(own) for own in pairs.values()]
    if links and not any(overlaps):
        counts = Counter(name for link in links for name in link.registration.lidars)
        best = max(lidars, key=lambda name: counts[name])
        return best, f"it is in {counts[best]} of {len(links)} links between stops"
    first = Counter(max(sorted(overlap), key=overlap.__getitem__) for overlap in overlaps if overlap)
    total = {name: fsum(overlap.get(name, 0.0) for overlap in overlaps) for name in lidars}
    best = max(lidars, key=lambda name: (first[name], total[name]))
    return best, f"most overlap in {first[best]} of {len(pairs)} snapshots"


def _overlap(pairs: Sequence[PairRegistration]) -> dict[str, float]:
    """Sum the fitness of each LiDAR's pairs; equal sums are equal in any order of the pairs."""
    fitness: defaultdict[str, list[float]] = defaultdict(list)
    for pair in pairs:
        for name in (pair.target, pair.source):
            fitness[name].append(pair.fitness)
    return {name: fsum(values) for name, values in fitness.items()}


def _rig(linked: LinkedRig) -> LinkedRig:
    """Add the snapshots to the residuals of pairs."""
    rig = linked.rig
    used = [pair.target_stop for pair in linked.within if pair.registration.lidars <= {*rig.poses}]
    residuals = tuple(
        replace(residual, snapshot=name) for name, residual in zip(used, rig.refinement.pairs, strict=False)
    )
    return replace(linked, rig=replace(rig, refinement=Refinement.of(residuals, rig.refinement.biases)))


def _estimates(target: str, pairs: SnapshotPairs, config: CalibrationConfig) -> dict[str, Mapping[str, Estimate]]:
    return {name: estimate_poses(target, own, config.refine) for name, own in pairs.items()}


def _time_limit(results: Collection[CalibrationResult], placed: Collection[str]) -> TimeLimit | None:
    """Return the pairs that snapshots did not reach and that could have placed a LiDAR; None if all had time."""
    limits = [result.time_limit for result in results if result.time_limit is not None]
    if not limits:
        return None
    missed = {pair for limit in limits for pair in limit.not_reached if not {*pair} <= {*placed}}
    return TimeLimit(limits[0].max_time_s, tuple(sorted(missed)))


def _placed_by(placing: int, snapshots: int, *, linked: bool) -> str:
    if linked and not placing:
        return f"placed by links between stops; none of {snapshots} stops places it alone"
    if not placing:
        return f"placed by pairs of several snapshots, though none of {snapshots} snapshots places it alone"
    return f"placed by {placing} of {snapshots} snapshots"


@dataclass(frozen=True, slots=True, eq=False)
class _JointRig:
    """The joint rig with the estimates of each snapshot.

    Args:
        kept: per snapshot, its registrations without contradicting ones.
        alone: per snapshot and LiDAR, the pose by that snapshot alone.
        agreed: the same by the kept registrations.
        inconsistent: per snapshot, its conflicts; the first LiDAR of each is to blame.
        doubts: per snapshot and LiDAR, the cycle that does not close.
    """

    target: str
    results: Mapping[str, CalibrationResult]
    kept: SnapshotPairs
    linked: LinkedRig
    alone: Mapping[str, Mapping[str, Estimate]]
    agreed: Mapping[str, Mapping[str, Estimate]]
    inconsistent: Mapping[str, tuple[PoseConflict, ...]]
    doubts: Mapping[str, Mapping[str, PairResidual]]
    limits: AcceptanceConfig

    @property
    def rig(self) -> RefinedRig:
        return self.linked.rig

    def stops(self) -> tuple[StopPose, ...]:
        """Return the poses of the vehicle at the stops that links connect."""
        found: list[StopPose] = []
        for group in self.linked.linked.groups():
            first = group[0]
            for name in group:
                pose = RigidTransform(first, name, self.rig.stops[name].matrix)
                found.append(StopPose(name, first, pose, self.rig.stop_covariances.get(name)))
        return tuple(found)

    def placement(self, lidar: str) -> LidarPlacement:
        if lidar == self.target:
            return place_target(lidar)
        if (told := self.linked.by_motions.get(lidar)) is not None:
            return self._by_motions(told)
        if lidar not in self.rig.covariances:
            return LidarPlacement(lidar, self._why_unplaced(lidar))
        estimates = [own[lidar] for own in self.agreed.values() if lidar in own]
        ratio = scatter_ratio(estimates)
        of_links = [link.registration for link in self.linked.linked.links]
        pairs = [*(pair for own in self.kept.values() for pair in own), *of_links]
        best = max((pair for pair in pairs if lidar in pair.lidars), key=lambda pair: pair.evidence)
        telling = [name for name, own in self.agreed.items() if lidar in own]
        telling = telling or [name for name, own in self.kept.items() if any(lidar in pair.lidars for pair in own)]
        covariance, covered = widened_by_doubts(
            self.rig.poses[lidar],
            self.rig.covariances[lidar] * np.outer(ratio, ratio),
            {name: self.doubts[name].get(lidar) for name in telling},
            self.rig.poses,
            self.limits,
        )
        how = _placed_by(len(estimates), len(self.results), linked=bool(of_links))
        knock = self.linked.possible_knock
        knocked = knock is not None and knock.matters(lidar, covariance)
        if knock is not None:
            covariance = knock.widened(lidar, covariance)
        return place(
            self.rig.poses[lidar],
            covariance,
            self.limits,
            f"{how}; {knock.text}" if knock is not None and knocked else how,
            covered,
            repeatability=self.rig.repeatability.get(lidar),
            fitness=best.fitness,
            rmse_m=best.rmse_m,
            sigma_from="snapshots" if knocked or np.any(ratio > 1.0) else "residuals",
            spread=spread_of(estimates),
        )

    def _by_motions(self, told: ToldPose) -> LidarPlacement:
        """Return the pose that motions tell, which is uncertain at best."""
        lidar = told.T_root_lidar.source
        found = place(told.T_root_lidar, told.covariance, self.limits, fitness=float("nan"))
        if found.T_target_source is None:
            why = self._why_unplaced(lidar).removesuffix(".")
            return replace(found, reason=f"{why}. Its motion between the stops: {found.reason}")
        sigma_mm = 1e3 * np.sqrt(np.diag(told.covariance)[3:])
        along = ", ".join(f"{axis} {sigma:.0f} mm" for axis, sigma in zip("xyz", sigma_mm, strict=True))
        told_by = ONLY_GROUND if lidar in self.rig.covariances else ONLY_MOTION
        reason = f"{told_by}: sigma along the axes of {self.target} {along}, limit {1e3 * self.limits.max_sigma_m:g} mm"
        return replace(found, status="uncertain", reason=reason)

    def _why_unplaced(self, lidar: str) -> str:
        against = next((each for each in self.linked.conflicts if lidar in (each.target, each.source)), None)
        if against is not None:
            return f"the pose that other stops tell is wrong: {against.text}"
        reason = why_unplaced_jointly(lidar, self.target, self.results, self.inconsistent)
        links = [link for link in self.linked.links if lidar in (link.target, link.source)]
        if not self.linked.links:
            return reason
        found = (
            f"{len(links)} registrations with other stops do not tell it either"
            if links
            else "no stop sees what it sees"
        )
        return f"{found}. {reason}"

    def _chances(self, snapshot: str, lidar: str) -> dict[str, float]:
        """Return how probable the difference to each other snapshot that counts is, if the covariances are right."""
        here = self.alone[snapshot][lidar]
        others = {name: own[lidar] for name, own in self.agreed.items() if name != snapshot and lidar in own}
        return {name: chance_of_difference(here, there) for name, there in others.items()}

    def report(self, run: SnapshotRun) -> SnapshotReport:
        deviations: dict[str, SnapshotDeviation] = {}
        for lidar, estimate in self.alone.get(run.name, {}).items():
            if lidar in self.rig.covariances:
                distance_m, angle_rad = estimate.pose.distance_to(self.rig.poses[lidar])
                chances = self._chances(run.name, lidar)
                deviations[lidar] = SnapshotDeviation(
                    lidar,
                    distance_m,
                    float(np.rad2deg(angle_rad)),
                    probability=min(chances.values(), default=None),
                    contradicts=tuple(name for name, chance in chances.items() if chance < LEAST_PROBABILITY),
                )
        for conflict in self.inconsistent.get(run.name, ()):
            if conflict.outvoted:
                lidar = conflict.lidars[0]
                found = deviations.get(lidar, SnapshotDeviation(lidar, conflict.distance_m, conflict.angle_deg))
                deviations[lidar] = replace(found, outlier=True)
        for knock in self.linked.knocks:
            if run.name in knock.left_out and knock.lidar in deviations:
                deviations[knock.lidar] = replace(deviations[knock.lidar], outlier=True)
        return SnapshotReport(
            name=run.name,
            source=run.source,
            sha256=run.source_sha256,
            outliers=tuple(lidar for lidar in sorted(deviations) if deviations[lidar].outlier),
            deviations=tuple(deviations[lidar] for lidar in sorted(deviations)),
            disputed=tuple(each.lidars[0] for each in self.inconsistent.get(run.name, ()) if not each.outvoted),
            refusal=run.refusal or None,
        )
