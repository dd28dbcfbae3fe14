# SPDX-License-Identifier: Apache-2.0
"""The order of the stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage, VerifyConfig
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.placements import Findings, placement_of
from multilica.results import (
    Assessment,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GroundPlane,
    LidarPlacement,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Refinement,
    Refusal,
    SensorHealth,
    Verdict,
)
from multilica.snapshot import Snapshot
from multilica.stages.coarse import find_hypotheses
from multilica.stages.contradiction import doubt_by_contradiction, doubt_by_open_pairs, is_contradicted
from multilica.stages.correspond import match_features
from multilica.stages.decide import decide, decide_by_fitness
from multilica.stages.features import compute_features
from multilica.stages.fine import Candidate, Side, hopeful, prepare_side, register_best
from multilica.stages.ground import estimate_ground
from multilica.stages.merge import Group, merge, pose_between
from multilica.stages.observability import arc_between_m
from multilica.stages.poses import is_distinct
from multilica.stages.preprocess import preprocess
from multilica.stages.prior import known_between, require_usable
from multilica.stages.refine import linked, refine
from multilica.stages.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.stages.sensor_health import examine_sensor
from multilica.stages.stillness import detect_motion, explain_motion
from multilica.stages.symmetry import doubt_by_symmetry
from multilica.stages.verify import assess_hypotheses, short_gicp
from multilica.stages.witness import Trial, Witness, judge, prepare_witness
from multilica.testimony import Testimony

__all__ = ["calibrate"]

# A pose that slides gives way by more.
_STILL_HELD_M = 0.05

Doubting = Callable[[Sequence[PairRegistration], Trial, VerifyConfig], Sequence[PairRegistration]]


def calibrate(
    snapshot: Snapshot,
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    prior: Extrinsics | None = None,
) -> CalibrationResult:
    """Find where every LiDAR of the snapshot sits relative to the target LiDAR.

    Args:
        snapshot: at least two LiDARs with returns.
        config: the default preset if None.
        observe: called with each event of `multilica.events` as it happens.
        prior: poses that are claimed beforehand, by the LiDARs' names: one more hypothesis for each pair that it has,
            judged as the others are. The result is the whole pose all the same.

    Returns:
        A pose or a reason per LiDAR; a LiDAR that cannot be placed is a normal outcome.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, the target has none, or the vehicle moves.
        UnknownNameError: the snapshot has no LiDAR of the target's name.
        UsageError: a prior that has not two of the LiDARs, or with verification off, so that nothing could judge it.
        MissingDependencyError: the configuration asks for an engine that is not installed.
    """
    config = config or CalibrationConfig()
    _require_two_lidars(snapshot)
    if config.target:
        snapshot[config.target]
    if prior is not None:
        require_usable(prior, snapshot, config)
    run = _Run(snapshot, config, observe, prior)
    observe(events.CalibrationStarted(snapshot, config, prior))
    try:
        with threadpool_limits(config.runtime.threads):
            for stage in STAGES[: STAGES.index(config.until) + 1]:
                run.stage(stage)
    except UnfitSnapshotError as error:
        observe(events.CalibrationFinished(run.refused(Refusal(error.code, str(error)))))
        raise
    result = run.result()
    observe(events.CalibrationFinished(result))
    return result


def _require_two_lidars(snapshot: Snapshot) -> None:
    seeing = [lidar.name for lidar in snapshot.lidars if lidar.points_count > 0]
    if len(seeing) < 2:
        found = ", ".join(seeing) or "none"
        raise UnfitSnapshotError(
            f"{snapshot.source or 'The snapshot'} has {len(seeing)} LiDAR(s) with returns ({found}); "
            "calibration needs at least two."
        )


@dataclass(slots=True)
class _Run:
    """What the stages have found so far."""

    snapshot: Snapshot
    config: CalibrationConfig
    observe: Observer
    prior: Extrinsics | None = None
    health: list[SensorHealth] = field(default_factory=list)
    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    features: dict[str, FeatureCloud] = field(default_factory=dict)
    matches: dict[PairKey, Correspondences] = field(default_factory=dict)
    coarse: dict[PairKey, CoarseResult] = field(default_factory=dict)
    assessments: dict[PairKey, tuple[Assessment, ...]] = field(default_factory=dict)
    witnesses: dict[str, Witness] = field(default_factory=dict)
    rough: dict[str, RegistrationCloud] = field(default_factory=dict)
    sides: dict[str, Side] = field(default_factory=dict)
    registrations: dict[PairKey, PairRegistration] = field(default_factory=dict)
    doubted: set[PairKey] = field(default_factory=set)
    target: str = ""
    target_reason: str = ""
    decisions: list[MergeDecision] = field(default_factory=list)
    group: Group | None = None
    merges: list[PairRegistration] = field(default_factory=list)
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)
    refinement: Refinement | None = None
    ground: GroundPlane | None = None
    timing_s: dict[str, float] = field(default_factory=dict)

    def stage(self, stage: Stage) -> None:
        """Run one stage between its two events."""
        work: dict[Stage, tuple[Callable[[], None], int]] = {
            "ingest": (lambda: None, 0),
            "preprocess": (self._preprocess, len(self.snapshot.lidars)),
            "features": (self._features, len(self.clouds)),
            "correspond": (self._correspond, len(self._pairs())),
            "coarse": (self._coarse, len(self._pairs())),
            "verify": (self._verify, len(self._pairs())),
            "fine": (self._fine, len(self._pairs())),
            "merge": (self._merge, len(self.clouds) - 1),
            "refine": (self._refine, 1),
            "ground": (self._ground, 1),
        }
        if stage not in work:
            return
        do, steps = work[stage]
        self.observe(events.StageStarted(stage, steps))
        start = time.perf_counter()
        do()
        self.timing_s[stage] = time.perf_counter() - start
        self.observe(events.StageFinished(stage, self.timing_s[stage]))

    def _pairs(self) -> list[PairKey]:
        return list(combinations(self.clouds, 2))

    @property
    def _threads(self) -> int:
        return self.config.runtime.threads

    def _preprocess(self) -> None:
        self._require_standstill()
        for lidar in self.snapshot.lidars:
            self.health.append(examine_sensor(lidar, self.config.preprocess.min_range_m, self.config.health))
            cloud = preprocess(lidar, self.config.preprocess, self.config.stillness)
            cloud = replace(cloud, health=self.health[-1])
            if len(cloud.points_m):
                self.clouds[lidar.name] = cloud
            self.observe(events.CloudPreprocessed(cloud))
        self._require_clouds()

    def _require_clouds(self) -> None:
        limits = self.config.preprocess
        where = f"{self.snapshot.source or 'The snapshot'} has"
        span = f"between {limits.min_range_m:g} m and {limits.max_range_m:g} m (preprocess.min_range_m, max_range_m)"
        if len(self.clouds) < 2:
            found = ", ".join(self.clouds) or "none"
            raise UnfitSnapshotError(
                f"{where} {len(self.clouds)} LiDAR(s) with returns {span} ({found}); calibration needs at least two."
            )
        if self.config.target and self.config.target not in self.clouds:
            raise UnfitSnapshotError(
                f"{where} no returns of the target LiDAR '{self.config.target}' {span}; "
                f"choose another target: {', '.join(self.clouds)}.",
                code="blind_target",
            )

    def _require_standstill(self) -> None:
        if not self.config.stillness.enabled:
            return
        motions = {lidar.name: detect_motion(lidar.scans, self.config.stillness) for lidar in self.snapshot.lidars}
        refusal = explain_motion(motions, self.snapshot.source)
        if refusal:
            raise UnfitSnapshotError(refusal, code="moving_vehicle")

    def _features(self) -> None:
        for name, cloud in self.clouds.items():
            self.features[name] = compute_features(cloud, self.config.features)
            self.observe(events.FeaturesComputed(self.features[name]))

    def _correspond(self) -> None:
        for target, source in self._pairs():
            matches = match_features(self.features[target], self.features[source], self.config.correspond)
            self.matches[target, source] = matches
            self.observe(events.CorrespondencesMatched(matches))

    def _coarse(self) -> None:
        for pair, matches in self.matches.items():
            known = known_between(self.prior, *pair)
            self.coarse[pair] = find_hypotheses(matches, self.config.coarse, self.config.runtime.seed, known)
            self.observe(events.HypothesesFound(self.coarse[pair], matches))

    def _verify(self) -> None:
        if not self.config.verify.enabled:
            return
        gicp = short_gicp(self.config.verify, self.config.fine)
        for name, cloud in self.clouds.items():
            self.rough[name] = prepare_registration_cloud(name, cloud.points_m, gicp, self._threads)
            self.witnesses[name] = prepare_witness(cloud, self.config.verify)
        for pair, coarse in self.coarse.items():
            self.assessments[pair] = self._assess(coarse)
            self.observe(events.HypothesesAssessed(*pair, self.assessments[pair]))

    def _assess(self, coarse: CoarseResult) -> tuple[Assessment, ...]:
        target, source = ((self.witnesses[name], self.rough[name]) for name in (coarse.target, coarse.source))
        gicp = short_gicp(self.config.verify, self.config.fine)
        return assess_hypotheses(target, source, coarse, self.config.verify, gicp, self._threads)

    def _fine(self) -> None:
        for name in self.clouds:
            self.sides[name] = self._side(Group.of_one(name))
        for pair in self._pairs():
            candidates = self._candidates(pair)
            if candidates:
                self.registrations[pair] = self._register(self.sides[pair[0]], self.sides[pair[1]], candidates)
        self._doubt_all()
        if self.config.verify.enabled:
            for voxel_size_m in self.config.features.further_voxel_sizes_m:
                self._search_again(voxel_size_m)

    def _search_again(self, voxel_size_m: float) -> None:
        """Look for poses between LiDARs that nothing links, with descriptors of another size."""
        accepted = [pair for pair in self.registrations.values() if pair.verdict.accepted]
        apart = tuple(
            pair for pair in self._pairs() if pair[1] not in linked(pair[0], accepted) and not self._is_left_open(pair)
        )
        if not apart:
            return
        self.observe(events.SearchWidened(apart, voxel_size_m))
        config = self.config.features.model_copy(update={"voxel_size_m": voxel_size_m})
        names = sorted({name for pair in apart for name in pair})
        features = {name: compute_features(self.clouds[name], config) for name in names}
        for pair in apart:
            matches = match_features(features[pair[0]], features[pair[1]], self.config.correspond)
            coarse = find_hypotheses(matches, self.config.coarse, self.config.runtime.seed)
            assessments = self._assess(coarse)
            if assessments:
                candidates = [_candidate(each) for each in assessments]
                registration = self._registered(self.sides[pair[0]], self.sides[pair[1]], candidates)
                if registration.verdict.accepted:
                    self.matches[pair], self.coarse[pair], self.assessments[pair] = matches, coarse, assessments
                    self.registrations[pair] = registration
                    self.observe(events.CorrespondencesMatched(matches))
                    self.observe(events.HypothesesFound(coarse, matches))
                    self.observe(events.HypothesesAssessed(*pair, assessments))
                    self.observe(events.PairRegistered(registration))
        self._doubt_all()

    def _is_left_open(self, pair: PairKey) -> bool:
        """Whether the scene, not the search, keeps the pair from being accepted."""
        registration = self.registrations.get(pair)
        codes = set() if registration is None else {reason.code for reason in registration.verdict.reasons}
        return pair in self.doubted or {"not_observable"} <= codes <= {"ambiguous", "not_observable"}

    def _doubt_all(self) -> None:
        for doubting in (doubt_by_symmetry, doubt_by_contradiction, doubt_by_open_pairs):
            self._doubt(doubting)

    def _doubt(self, doubting: Doubting) -> None:
        settled = list(self.registrations.items())
        doubted = doubting([pair for _, pair in settled], self._testify, self.config.verify)
        for (key, before), after in zip(settled, doubted, strict=True):
            if after is not before:
                self.registrations[key] = after
                self.doubted.add(key)
                self.observe(events.PairRegistered(after))

    def _testify(self, pose: RigidTransform) -> Testimony:
        here, there = (
            [(RigidTransform.identity(name, name), self.witnesses[name])] for name in (pose.target, pose.source)
        )
        limits = self.config.verify
        return judge(here, there, pose, limits.final_tolerance_m, limits.final_tolerance_deg)

    def _candidates(self, pair: PairKey) -> list[Candidate]:
        if self.config.verify.enabled:
            return [_candidate(each) for each in self.assessments[pair]]
        return [Candidate(each.T_target_source, index) for index, each in enumerate(self.coarse[pair].hypotheses)]

    def _side(self, group: Group) -> Side:
        if len(group.poses) == 1 and group.root in self.sides:
            return self.sides[group.root]
        witnesses = [(pose, self.witnesses[name]) for name, pose in sorted(group.poses.items()) if self.witnesses]
        points_m = self._merged_points(group)
        return prepare_side(group.root, points_m, witnesses, self.config.verify, self.config.fine, self._threads)

    def _register(
        self, target: Side, source: Side, candidates: Sequence[Candidate], *, fit: bool = True
    ) -> PairRegistration:
        registration = self._registered(target, source, candidates, fit=fit)
        self.observe(events.PairRegistered(registration))
        return registration

    def _registered(
        self, target: Side, source: Side, candidates: Sequence[Candidate], *, fit: bool = True
    ) -> PairRegistration:
        config = self.config
        registration = register_best(
            target, source, candidates, config.verify, config.fine, config.refine, self._threads, fit=fit
        )
        if registration.assessments:
            verdict = decide(registration.assessments, config.verify)
        else:
            verdict = decide_by_fitness(registration, config.merge)
        return replace(registration, verdict=verdict)

    def _merge(self) -> None:
        self.target, self.target_reason = self._choose_target()
        self.observe(events.TargetChosen(self.target, self.target_reason))
        self.group = Group.of_one(self.target)
        steps = merge(
            self.target,
            tuple(self.clouds),
            tuple(self.registrations.values()),
            self._reregister,
            self.config.merge,
        )
        for step in steps:
            self.decisions.append(step.decision)
            if step.chosen is not None:
                self.merges.append(step.chosen)
            self.group = step.groups[0]
            self.observe(events.MergeStepTaken(step.decision, tuple(step.grown.poses.values())))

    def _choose_target(self) -> tuple[str, str]:
        if self.config.target:
            return self.config.target, "as asked for"
        overlap = dict.fromkeys(self.clouds, 0.0)
        for registration in self.registrations.values():
            if registration.verdict.accepted:
                overlap[registration.target] += registration.fitness
                overlap[registration.source] += registration.fitness
        best = max(overlap, key=lambda name: (overlap[name], len(self.clouds[name].points_m)))
        if overlap[best] == 0.0:
            return best, "the LiDAR with the most points; no pair was accepted"
        return best, f"the LiDAR with the most overlap: fitness over its pairs adds up to {overlap[best]:.2f}"

    def _reregister(self, group: Group, other: Group, hints: Sequence[PairRegistration]) -> PairRegistration | None:
        """The groups as wholes, from all that is known; if that leaves doubt, from what pairs were accepted for.

        Two wholes have more poses that fit by chance than two LiDARs. Those that no pair was accepted for need not
        stand against one that was, unless one of them has more evidence and is not rejected. What other pairs
        contradict is not tried again. What an accepted pair joins takes its information from that pair.
        """
        contradicted = {pair for pair, registration in self.registrations.items() if is_contradicted(registration)}
        known = [hint.T_target_source for hint in hints if not is_contradicted(hint)]
        known += [
            assessment.T_target_source
            for pair, assessments in self.assessments.items()
            if len({*pair} & {*group.poses}) == 1 and len({*pair} & {*other.poses}) == 1 and pair not in contradicted
            for assessment in self._hopeful(assessments)
        ]
        accepted = [hint.T_target_source for hint in hints if hint.verdict.accepted]
        link = self._register_groups(group, other, known, fit=not accepted)
        if link is None or link.verdict.accepted:
            return link
        again = self._register_groups(group, other, accepted, fit=not accepted) if self.config.verify.enabled else None
        if again is None or _outdoes(link, again, self.config.verify.rival_reach_m):
            return link
        if not again.verdict.accepted:
            again = self._upheld(again, [pose_between(group, other, pose) for pose in accepted])
        return again if again.verdict.accepted else link

    def _upheld(self, link: PairRegistration, accepted: Sequence[RigidTransform]) -> PairRegistration:
        """More points hardly loosen what an accepted pair holds by itself, but those of a group are thinned more."""
        pose = _the_way_of(link.T_target_source, accepted[0])
        holds = [assessment.hold for assessment in link.assessments]
        if not _is_only_loose(link) or len(holds) != 1 or holds[0] is None or holds[0].pushed_off_m > _STILL_HELD_M:
            return link
        if min(arc_between_m(pose, known) for known in accepted) > _STILL_HELD_M:
            return link
        upheld = replace(link, verdict=Verdict("accept"))
        self.observe(events.PairRegistered(upheld))
        return upheld

    def _register_groups(
        self, group: Group, other: Group, known: Sequence[RigidTransform], *, fit: bool
    ) -> PairRegistration | None:
        candidates = [Candidate(pose_between(group, other, pose), -1) for pose in known]
        near = [each for each in candidates if self._is_near(each.T_target_source)]
        return self._register(self._side(group), self._side(other), near, fit=fit) if near else None

    def _hopeful(self, assessments: Sequence[Assessment]) -> list[Assessment]:
        return [assessments[index] for index in hopeful([each.evidence for each in assessments], self.config.verify)]

    def _is_near(self, pose: RigidTransform) -> bool:
        return float(np.linalg.norm(pose.xyz_m)) <= self.config.coarse.max_baseline_m

    def _merged_points(self, group: Group) -> FloatArray:
        return np.concatenate([pose.apply(self.clouds[name].points_m) for name, pose in sorted(group.poses.items())])

    def _refine(self) -> None:
        if not self.config.refine.enabled or self.group is None:
            return
        if self.config.verify.enabled:
            self._close_loops(self.group)
        rig = refine(self.target, self.group.poses, self._trusted_pairs(), self.config.refine)
        self.group = Group(self.target, rig.poses)
        self.covariances, self.refinement = rig.covariances, rig.refinement
        self.observe(events.RigRefined(rig.refinement, tuple(pose for _, pose in sorted(rig.poses.items()))))

    def _close_loops(self, group: Group) -> None:
        """Register placed pairs that were not accepted from where the rig puts them; the search may have missed it."""
        for pair in self._pairs():
            before = self.registrations.get(pair)
            if set(pair) <= set(group.poses) and (before is None or not before.verdict.accepted):
                placed = group.poses[pair[0]].inverse() @ group.poses[pair[1]]
                if before is not None and _is_loose_at(before, placed):
                    continue
                after = self._register(self.sides[pair[0]], self.sides[pair[1]], [Candidate(placed, -1)])
                if after.verdict.accepted:
                    self.registrations[pair] = after

    def _trusted_pairs(self) -> list[PairRegistration]:
        """The accepted pairs of single LiDARs, with the merges that joined what no such pair joins."""
        trusted = [pair for pair in self.registrations.values() if pair.verdict.accepted]
        for merge_link in self.merges:
            if merge_link.source not in linked(merge_link.target, trusted):
                trusted.append(merge_link)
        return trusted

    def _ground(self) -> None:
        if not self.config.ground.enabled or self.group is None:
            return
        self.ground, reason = estimate_ground(
            self.target, self._merged_points(self.group), self.config.ground, self.config.runtime.seed
        )
        self.observe(events.GroundEstimated(self.ground, reason))

    def result(self) -> CalibrationResult:
        """The outcome as far as the stages went."""
        target = self.target or self.config.target or self.snapshot.names[0]
        findings = Findings(
            target=target,
            poses={} if self.group is None else self.group.poses,
            covariances=self.covariances,
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            seeing=frozenset(self.clouds),
            until=self.config.until,
            prior=self.prior,
        )
        return CalibrationResult(
            target=target,
            target_reason=self.target_reason or "no pair was registered",
            placements=tuple(placement_of(name, findings) for name in self.snapshot.names),
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            refinement=self.refinement,
            ground=self.ground,
            trusted=tuple(self._trusted_pairs()),
            timing_s=dict(self.timing_s),
            health=tuple(self.health),
        )

    def refused(self, refusal: Refusal) -> CalibrationResult:
        """The outcome of a snapshot that is not fit: no LiDAR has a place, not even the target."""
        return CalibrationResult(
            target=self.config.target or self.snapshot.names[0],
            target_reason="the snapshot was refused",
            placements=tuple(LidarPlacement(name, reason=refusal.text) for name in self.snapshot.names),
            timing_s=dict(self.timing_s),
            health=tuple(self.health),
            refusal=refusal,
        )


def _candidate(assessment: Assessment) -> Candidate:
    return Candidate(assessment.T_target_source, assessment.hypothesis, assessment.origin, assessment.evidence)


def _is_loose_at(registration: PairRegistration, pose: RigidTransform) -> bool:
    """Whether the registration ended at this pose, and nothing but too loose a hold speaks against it."""
    ended_at = _the_way_of(registration.T_target_source, pose)
    return _is_only_loose(registration) and not is_distinct(pose, [ended_at])


def _is_only_loose(registration: PairRegistration) -> bool:
    return [reason.code for reason in registration.verdict.reasons] == ["not_observable"]


def _the_way_of(pose: RigidTransform, other: RigidTransform) -> RigidTransform:
    """The pose, or its inverse, that goes between the same two as the other the same way."""
    return pose if pose.target == other.target else pose.inverse()


def _outdoes(link: PairRegistration, other: PairRegistration, reach_m: float) -> bool:
    """Whether a registration of the same groups, not rejected, has more evidence for another pose within reach."""
    elsewhere = is_distinct(link.T_target_source, [_the_way_of(other.T_target_source, link.T_target_source)])
    near = float(np.linalg.norm(link.T_target_source.xyz_m)) <= reach_m
    return link.verdict.outcome == "undecided" and elsewhere and near and link.evidence > other.evidence
