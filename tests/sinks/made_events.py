# SPDX-License-Identifier: Apache-2.0
"""Events of a small made-up calibration, in the order of the pipeline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import (
    PRIOR,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GicpStep,
    GroundPlane,
    Hypothesis,
    LidarPlacement,
    MergeCandidate,
    MergeDecision,
    PairRegistration,
    PairResidual,
    PreprocessedCloud,
    Reason,
    Refinement,
    Registration,
    Verdict,
)
from multilica.results.visibility_score import VisibilityScore
from multilica.snapshot import LidarScans, Scan, Snapshot

__all__ = ["LIDARS", "STAMP_NS", "TRUTH", "UNPLACED", "made_events"]

LIDARS = ("front left/1", "rear", "top")
TARGET = "top"
UNPLACED = "rear"
STAMP_NS = 1_700_000_000_000_000_000
SEED = 7
TRUTH = {
    "front left/1": RigidTransform.from_xyz_rpy(TARGET, "front left/1", (1.5, 0.7, -0.4), (0.02, 0.6, 1.5)),
    "rear": RigidTransform.from_xyz_rpy(TARGET, "rear", (-2.0, 0.1, -0.5), (-0.1, 0.3, 3.0)),
    "top": RigidTransform.identity(TARGET, TARGET),
}


def made_events(
    outcome: str = "complete", until: Stage = "ground", *, prior: Extrinsics | None = None, **config: Any
) -> Iterator[events.Event]:
    """A run that places all LiDARs (`complete`), or all but `UNPLACED` (`partial`), or none (`failed`).

    With a prior, every registration starts from it.
    """
    settings = CalibrationConfig(target=TARGET, until=until, ground={"enabled": True}, **config)
    run = _MadeRun(outcome, prior)
    yield events.CalibrationStarted(run.snapshot, settings, prior)
    for stage in STAGES[: STAGES.index(until) + 1]:
        yield events.StageStarted(stage, 0)
        yield from getattr(run, stage)()
        yield events.StageFinished(stage, 0.01)
    yield events.CalibrationFinished(run.result(until))


class _MadeRun:
    def __init__(self, outcome: str, prior: Extrinsics | None) -> None:
        self.outcome = outcome
        self.prior = prior
        self.random = np.random.default_rng(SEED)
        world = _world(self.random)
        self.points = {
            name: pose.inverse().apply(world + self.random.normal(scale=0.01, size=world.shape))
            for name, pose in TRUTH.items()
        }
        self.snapshot = _snapshot(self.points)
        self.features_of: dict[str, FeatureCloud] = {}
        self.registrations: dict[tuple[str, str], PairRegistration] = {}
        self.decisions: list[MergeDecision] = []
        self.ground_plane: GroundPlane | None = None

    @property
    def refused(self) -> set[str]:
        return {"complete": set(), "partial": {UNPLACED}, "failed": {*LIDARS} - {TARGET}}[self.outcome]

    def pairs(self):
        return list(combinations(LIDARS, 2))

    def truth(self, target: str, source: str) -> RigidTransform:
        return TRUTH[target].inverse() @ TRUTH[source]

    def ingest(self):
        return ()

    def preprocess(self):
        for name, points in self.points.items():
            near, far = self.random.normal(scale=0.2, size=(9, 3)), self.random.normal(scale=200.0, size=(4, 3))
            dropped = {"too_near": near, "too_far": far}
            yield events.CloudPreprocessed(PreprocessedCloud(name, points, points[::2], dropped))

    def features(self):
        for name, points in self.points.items():
            thin = points[::3]
            normals = -thin / np.linalg.norm(thin, axis=1, keepdims=True)
            self.features_of[name] = FeatureCloud(name, thin, normals, np.zeros((len(thin), 33)))
            yield events.FeaturesComputed(self.features_of[name])

    def correspond(self):
        for target, source in self.pairs():
            yield events.CorrespondencesMatched(self._matches(target, source))

    def _matches(self, target: str, source: str) -> Correspondences:
        """Every fourth match is right."""
        to, of = self.features_of[target], self.features_of[source]
        count = 80
        rows = np.arange(count)
        wrong = (rows * 37 + 11) % len(of.points_m)
        at = np.where(rows % 4 == 0, rows, wrong)
        return Correspondences(
            target, source, to.points_m[rows], of.points_m[at], to.normals[rows], of.normals[at], rows / count
        )

    def coarse(self):
        for target, source in self.pairs():
            matches = self._matches(target, source)
            yield events.HypothesesFound(self._coarse_result(target, source, len(matches)), matches)

    def _coarse_result(self, target: str, source: str, count: int) -> CoarseResult:
        claimed = self._claimed(target, source, count)
        if self.outcome == "failed" and UNPLACED in (target, source):
            return CoarseResult(target, source, claimed)
        right = np.arange(count) % 4 == 0
        turned = RigidTransform.from_xyz_rpy(target, target, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
        good = Hypothesis(self.truth(target, source), right, float(right.sum()), "cliques")
        bad = Hypothesis(turned @ self.truth(target, source), np.zeros(count, dtype=bool), 5.0, "cliques")
        return CoarseResult(target, source, (good, bad, *claimed), graph_nodes=count, graph_edges=200)

    def _claimed(self, target: str, source: str, count: int) -> tuple[Hypothesis, ...]:
        if self.prior is None:
            return ()
        return (Hypothesis(self.prior.between(target, source), np.zeros(count, dtype=bool), 3.0, PRIOR),)

    def verify(self):
        for target, source in self.pairs():
            hypotheses = self._coarse_result(target, source, 80).hypotheses
            scored_poses = tuple(self._assessment(source, index, one) for index, one in enumerate(hypotheses))
            yield events.HypothesesVerified(target, source, scored_poses)

    def _assessment(self, source: str, index: int, hypothesis: Hypothesis) -> Registration:
        target = hypothesis.T_target_source.target
        probes, target_probes = (self.points[name][:: 5 + LIDARS.index(name)] for name in (source, target))
        labels, target_labels = ((np.arange(len(each)) % 4).astype(np.uint8) for each in (probes, target_probes))
        counts = (90, 1, 5, 5) if index == 0 else (20, 60, 5, 5)
        visibility = VisibilityScore(*counts, np.eye(6), labels, target_labels=target_labels)
        pose, fitness = hypothesis.T_target_source, 0.8 - 0.3 * index
        return Registration(
            index, pose, visibility, fitness, 0.05, 1.0, probes, hypothesis.origin, target_probes_m=target_probes
        )

    def fine(self):
        for target, source in self.pairs():
            if not self._coarse_result(target, source, 80).hypotheses:
                continue
            # The pipeline registers the sparser cloud against the denser one, in either order of matching.
            swap = (target, source) == self.pairs()[0]
            pair = (source, target) if swap else (target, source)
            self.registrations[pair] = self._registration(*pair, hypothesis=0 if self.prior is None else 2)
            yield events.PairRegistered(self.registrations[pair])
            if self.registrations[pair].verdict.reasons:
                yield events.VerdictChanged(self.registrations[pair])
        yield events.SearchWidened(tuple(self.pairs()[-1:]), 0.5)

    def _registration(self, target: str, source: str, hypothesis: int, *, refused: bool = False) -> PairRegistration:
        refused = refused or bool(self.refused & {target, source})
        fitness = 0.1 if refused else 0.8
        best, other = registrations = self._registrations(target, source, hypothesis)
        share = max(0.0, other.evidence / best.evidence)
        doubts = (
            Reason("too_little_overlap", 12.0, 50.0, "only 12 points lie on surfaces; expected 50"),
            Reason("ambiguous", share, 0.7, f"a pose 3.00 m and 180 deg away fits as well ({share:.0%})", other),
            Reason("not_observable", 0.04, 0.1, "the scene does not constrain y (curvature 0.04, limit 0.1)"),
        )
        steps = tuple(
            GicpStep(3 * (k + 1), 2.0 / (k + 1), 100 + k, 10.0 / (k + 1), 0.1 / (k + 1), 0.01) for k in range(4)
        )
        return PairRegistration(
            target,
            source,
            self.truth(target, source),
            fitness,
            0.06,
            120,
            converged=True,
            iterations=12,
            engine="small_gicp",
            hypothesis=hypothesis,
            hessian=np.eye(6),
            steps=steps,
            registrations=registrations,
            verdict=Verdict("reject", doubts) if refused else Verdict("accept"),
        )

    def _registrations(self, target: str, source: str, hypothesis: int) -> tuple[Registration, ...]:
        origin = PRIOR if self.prior is not None and hypothesis >= 0 else ""
        truth = self.truth(target, source)
        turned = RigidTransform.from_xyz_rpy(target, target, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi)) @ truth
        first = self._assessment(source, 0, Hypothesis(truth, np.zeros(0), 0.0, origin))
        return (
            replace(first, hypothesis=hypothesis),
            self._assessment(source, 1, Hypothesis(turned, np.zeros(0), 0.0, "")),
        )

    def merge(self):
        yield events.TargetChosen(TARGET, "set by --target")
        placed = [TARGET]
        for step, name in enumerate(sorted(set(LIDARS) - {TARGET} - self.refused)):
            if step:
                yield events.GroupsRegistered(self._registration(TARGET, name, hypothesis=-1))
            placed.append(name)
            chosen = MergeCandidate(TARGET, name, 0.8, 0.06, passes=True)
            yield self._merge_step(step, chosen, placed)
        if self.refused:
            yield self._merge_step(len(self.decisions), None, placed)

    def _merge_step(self, step: int, chosen: MergeCandidate | None, placed: list[str]) -> events.MergeStepTaken:
        left = sorted(set(LIDARS) - set(placed))
        refusal = "too little overlap"
        others = tuple(MergeCandidate(TARGET, name, 0.1, np.inf, passes=False, reason=refusal) for name in left)
        pairs = (*((chosen,) if chosen else ()), *others)
        reason = f"merged {chosen.source} into top" if chosen else "stopped: the best has fitness 0.100, below 0.2"
        groups = (tuple(sorted(placed)), *((name,) for name in left))
        self.decisions.append(MergeDecision(step, pairs, chosen, reason, groups))
        poses = tuple(TRUTH[name] for name in sorted(placed)) if chosen else ()
        return events.MergeStepTaken(self.decisions[-1], poses)

    def refine(self):
        yield events.LoopRegistered(self._registration(*self.pairs()[0], hypothesis=-1, refused=True))
        residual = PairResidual(TARGET, LIDARS[0], 0.004, 0.02, 0.001, 0.01, 0.9)
        placed = tuple(pose for name, pose in TRUTH.items() if name not in self.refused)
        yield events.RigRefined(Refinement((residual,)), placed)

    def ground(self):
        base = RigidTransform.from_xyz_rpy("base", TARGET, (0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
        self.ground_plane = GroundPlane(np.array([0.0, 0.0, 1.0]), 2.0, base, 0.4)
        yield events.GroundEstimated(self.ground_plane, "40 of 100 points lie on a plane")

    def result(self, until: Stage) -> CalibrationResult:
        merged = STAGES.index(until) >= STAGES.index("merge")
        return CalibrationResult(
            TARGET,
            "as asked for",
            tuple(self._placement(name, merged=merged) for name in LIDARS),
            tuple(self.registrations.values()),
            tuple(self.decisions),
            self.ground_plane,
            {"fine": 0.01, "broken": float("nan")},
        )

    def _placement(self, name: str, *, merged: bool) -> LidarPlacement:
        placement = self._placed(name, merged=merged)
        claimed = None if self.prior is None else self.prior.between(TARGET, name)
        return replace(placement, T_target_source_prior=claimed)

    def _placed(self, name: str, *, merged: bool) -> LidarPlacement:
        if name == TARGET:
            return LidarPlacement(name, "the target", placed=True, T_target_source=TRUTH[name], fitness=1.0, rmse_m=0.0)
        if not merged:
            return LidarPlacement(name, "stopped early as asked")
        if name in self.refused:
            return LidarPlacement(name, "its best registration has fitness 0.100, below 0.2")
        pose, covariance = TRUTH[name], np.diag([1e-8, 1e-8, 4e-8, 1e-6, 4e-6, 9e-6])
        return LidarPlacement(
            name, "placed", placed=True, T_target_source=pose, fitness=0.8, rmse_m=0.06, covariance=covariance
        )


def _world(random: np.random.Generator) -> np.ndarray:
    """A street: ground, two facades, a few poles."""
    ground = np.column_stack([random.uniform(-20, 20, (500, 2)), np.full(500, -2.0)])
    left = np.column_stack([random.uniform(-20, 20, 300), np.full(300, 8.0), random.uniform(-2, 4, 300)])
    right = np.column_stack([random.uniform(-20, 20, 300), np.full(300, -6.0), random.uniform(-2, 6, 300)])
    poles = np.column_stack([random.choice([-9.0, 3.0, 11.0], 100), np.full(100, 4.0), random.uniform(-2, 3, 100)])
    return np.concatenate([ground, left, right, poles])


def _scans(cloud: np.ndarray, stamp_ns: int) -> tuple[Scan, Scan]:
    return Scan(cloud[::2], stamp_ns), Scan(cloud[1::2], STAMP_NS + 10**8)


def _snapshot(points: dict[str, np.ndarray]) -> Snapshot:
    lidars = tuple(
        LidarScans(name, _scans(cloud, STAMP_NS + 1000 * index), f"{name}_frame", f"/{name}")
        for index, (name, cloud) in enumerate(points.items())
    )
    return Snapshot(lidars, "drive.mcap", "c0ffee" * 10 + "abcd", notes=("12 of 20 scans, then the file ends",))
