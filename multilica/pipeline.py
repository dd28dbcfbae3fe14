# SPDX-License-Identifier: Apache-2.0
"""The order of the stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import (
    Assessment,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GroundPlane,
    LidarPlacement,
    MergeCandidate,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
)
from multilica.snapshot import Snapshot
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features
from multilica.stages.features import compute_features
from multilica.stages.fine import register_pair
from multilica.stages.ground import estimate_ground
from multilica.stages.merge import Group, merge
from multilica.stages.preprocess import preprocess
from multilica.stages.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.stages.verify import Witness, assess_hypotheses, prepare_witness, short_gicp

__all__ = ["calibrate"]


def calibrate(
    snapshot: Snapshot, config: CalibrationConfig | None = None, observe: Observer = events.ignore
) -> CalibrationResult:
    """Find where every LiDAR of the snapshot sits relative to the target LiDAR.

    Args:
        snapshot: at least two LiDARs with returns.
        config: the default preset if None.
        observe: called with each event of `multilica.events` as it happens.

    Returns:
        A pose or a reason per LiDAR; a LiDAR that cannot be placed is a normal outcome.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns.
        UnknownNameError: the snapshot has no LiDAR of the target's name.
        MissingDependencyError: the configuration asks for an engine that is not installed.
    """
    config = config or CalibrationConfig()
    _require_two_lidars(snapshot)
    if config.target:
        snapshot[config.target]
    run = _Run(snapshot, config, observe)
    observe(events.CalibrationStarted(snapshot, config))
    with threadpool_limits(config.runtime.threads):
        for stage in STAGES[: STAGES.index(config.until) + 1]:
            run.stage(stage)
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
    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    features: dict[str, FeatureCloud] = field(default_factory=dict)
    matches: dict[PairKey, Correspondences] = field(default_factory=dict)
    coarse: dict[PairKey, CoarseResult] = field(default_factory=dict)
    assessments: dict[PairKey, tuple[Assessment, ...]] = field(default_factory=dict)
    registration_clouds: dict[str, RegistrationCloud] = field(default_factory=dict)
    registrations: dict[PairKey, PairRegistration] = field(default_factory=dict)
    target: str = ""
    target_reason: str = ""
    decisions: list[MergeDecision] = field(default_factory=list)
    group: Group | None = None
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
        for lidar in self.snapshot.lidars:
            cloud = preprocess(lidar, self.config.preprocess)
            if len(cloud.points_m):
                self.clouds[lidar.name] = cloud
            self.observe(events.CloudPreprocessed(cloud))

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
            self.coarse[pair] = find_hypotheses(matches, self.config.coarse, self.config.runtime.seed)
            self.observe(events.HypothesesFound(self.coarse[pair], matches))

    def _verify(self) -> None:
        if not self.config.verify.enabled:
            return
        gicp = short_gicp(self.config.verify, self.config.fine)
        witnesses: dict[str, Witness] = {
            name: prepare_witness(cloud, self.config.verify, self.config.fine, self._threads)
            for name, cloud in self.clouds.items()
        }
        for (target, source), coarse in self.coarse.items():
            assessments = assess_hypotheses(
                witnesses[target], witnesses[source], coarse, self.config.verify, gicp, self._threads
            )
            self.assessments[target, source] = assessments
            self.observe(events.HypothesesAssessed(target, source, assessments))

    def _fine(self) -> None:
        for name, cloud in self.clouds.items():
            self.registration_clouds[name] = prepare_registration_cloud(
                name, cloud.points_m, self.config.fine, self._threads
            )
        for target, source in self._pairs():
            start = self._best_start((target, source))
            if start is None:
                continue
            hypothesis, pose = start
            clouds = self.registration_clouds
            registration = register_pair(
                clouds[target], clouds[source], pose, hypothesis, self.config.fine, self._threads
            )
            self.registrations[target, source] = registration
            self.observe(events.PairRegistered(registration, best=True))

    def _best_start(self, pair: PairKey) -> tuple[int, RigidTransform] | None:
        assessed = self.assessments.get(pair)
        if assessed:
            return assessed[0].hypothesis, assessed[0].T_target_source
        hypotheses = self.coarse[pair].hypotheses
        return (0, hypotheses[0].T_target_source) if hypotheses else None

    def _merge(self) -> None:
        self.target, self.target_reason = self._choose_target()
        self.observe(events.TargetChosen(self.target, self.target_reason))
        self.group = Group.of_one(self.target)
        steps = merge(
            self.target,
            tuple(self.clouds),
            tuple(self.registrations.values()),
            self._reregister,
            self._passes,
            self.config.merge,
        )
        for step in steps:
            self.decisions.append(step.decision)
            self.group = step.groups[0]
            self.observe(events.MergeStepTaken(step.decision, tuple(_grown(step.decision, step.groups).poses.values())))

    def _choose_target(self) -> tuple[str, str]:
        if self.config.target:
            return self.config.target, "as asked for"
        overlap = dict.fromkeys(self.clouds, 0.0)
        for registration in self.registrations.values():
            if self._passes(registration):
                overlap[registration.target] += registration.fitness
                overlap[registration.source] += registration.fitness
        best = max(overlap, key=lambda name: (overlap[name], len(self.clouds[name].points_m)))
        return best, f"the LiDAR with the most overlap: fitness over its pairs adds up to {overlap[best]:.2f}"

    def _passes(self, registration: PairRegistration) -> bool:
        return registration.fitness >= self.config.merge.fitness_threshold

    def _reregister(self, group: Group, other: Group, hints: Sequence[PairRegistration]) -> PairRegistration:
        clouds = [
            prepare_registration_cloud(part.root, self._merged_points(part), self.config.fine, self._threads)
            for part in (group, other)
        ]
        registration = register_pair(
            clouds[0], clouds[1], _between_groups(group, other, hints[0]), -1, self.config.fine, self._threads
        )
        self.observe(events.PairRegistered(registration, best=True))
        return registration

    def _merged_points(self, group: Group) -> FloatArray:
        return np.concatenate([pose.apply(self.clouds[name].points_m) for name, pose in sorted(group.poses.items())])

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
        return CalibrationResult(
            target=target,
            target_reason=self.target_reason or "no pair was registered",
            placements=tuple(self._placement(name, target) for name in self.snapshot.names),
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            ground=self.ground,
            timing_s=dict(self.timing_s),
        )

    def _placement(self, name: str, target: str) -> LidarPlacement:
        if name == target:
            pose, fitness, rmse_m, reason = RigidTransform.identity(name, name), 1.0, 0.0, "the target"
        elif self.group is not None and name in self.group.poses:
            link = _link_of(name, self.decisions)
            pose, fitness, rmse_m, reason = self.group.poses[name], link.fitness, link.rmse_m, "placed"
        else:
            return LidarPlacement(name, reason=self._why_not_placed(name))
        return LidarPlacement(name, reason, placed=True, T_target_source=pose, fitness=fitness, rmse_m=rmse_m)

    def _why_not_placed(self, name: str) -> str:
        if name not in self.clouds and self.clouds:
            return "no returns are left of it"
        if self.config.until in STAGES[: STAGES.index("merge")]:
            return f"stopped after stage {self.config.until} as asked"
        own = [pair for pair in self.registrations.values() if name in (pair.target, pair.source)]
        if not own:
            return "no pose was found against any other LiDAR"
        best = max(own, key=lambda pair: pair.fitness)
        other = best.target if best.source == name else best.source
        return (
            f"its best registration, with {other}, has fitness {best.fitness:.3f}, below "
            f"{self.config.merge.fitness_threshold:g}"
        )


def _between_groups(group: Group, other: Group, hint: PairRegistration) -> RigidTransform:
    """Where `hint`, a registration between two of their members, puts the other group's root in this one's."""
    known = hint.T_target_source
    if hint.target in other.poses:
        known = known.inverse()
    return group.poses[known.target] @ known @ other.poses[known.source].inverse()


def _grown(decision: MergeDecision, groups: Sequence[Group]) -> Group:
    """The group that the decision made larger; the target's if it made none."""
    if decision.chosen is None:
        return groups[0]
    return next(group for group in groups if decision.chosen.target in group.poses)


def _link_of(name: str, decisions: Sequence[MergeDecision]) -> MergeCandidate:
    """The pair whose merge brought the LiDAR into the target's group."""
    chosen = (decision.chosen for decision in decisions if name in decision.groups[0])
    return next(candidate for candidate in chosen if candidate is not None)
