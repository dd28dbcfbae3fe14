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
from multilica.orchestration.pairs import PAIR_STAGES
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
from tests.sinks.made_drive import STOPS, linked, stops_linked
from tests.sinks.made_scans import made_snapshot, made_street
from tests.sinks.made_surfaces import made_surfaces

LIDARS = ("front left/1", "rear", "top")
TARGET = "top"
UNPLACED = "rear"
SEED = 7
IMPRECISE = Reason("imprecise", 0.03, 0.02, "sigma 30 mm, limit 20 mm")
TRUTH = {
    "front left/1": RigidTransform.from_xyz_rpy(TARGET, "front left/1", (1.5, 0.7, -0.4), (0.02, 0.6, 1.5)),
    "rear": RigidTransform.from_xyz_rpy(TARGET, "rear", (-2.0, 0.1, -0.5), (-0.1, 0.3, 3.0)),
    "top": RigidTransform.identity(TARGET, TARGET),
}


def made_events(
    outcome: str = "complete",
    until: Stage = "ground",
    *,
    prior: Extrinsics | None = None,
    at_stops: bool = False,
    **config: Any,
) -> Iterator[events.Event]:
    """A run that places all LiDARs (`complete`), or all but `UNPLACED` (`partial`), or none (`failed`).

    Of an `uncertain` run, the pose of `UNPLACED` has a standard deviation of 30 mm along x.
    With a prior, every registration starts from it. The snapshot may be one of several stops of a drive.
    """
    settings = CalibrationConfig(target=TARGET, until=until, ground={"enabled": True}, **config)
    run = _MadeRun(outcome, prior)
    stops = tuple(stop.name for stop in STOPS) if at_stops else ()
    yield events.CalibrationStarted(run.snapshot, settings, prior, stops)
    due = STAGES[: STAGES.index(until) + 1]
    for together in (("ingest",), ("preprocess",), ("features",), PAIR_STAGES, ("merge",), ("refine",), ("ground",)):
        stages = [stage for stage in together if stage in due]
        yield from (events.StageStarted(stage, 0) for stage in stages)
        if together == PAIR_STAGES:
            yield from run.search(stages)
        else:
            yield from (event for stage in stages for event in getattr(run, stage)())
        if at_stops and together == ("refine",):
            yield stops_linked(run.points)
        yield from (events.StageFinished(stage, 0.01) for stage in stages)
    result = run.result(until)
    yield events.CalibrationFinished(linked(result) if at_stops else result)


class _MadeRun:
    def __init__(self, outcome: str, prior: Extrinsics | None) -> None:
        self.outcome = outcome
        self.prior = prior
        self.random = np.random.default_rng(SEED)
        world = made_street(self.random)
        self.points = {
            name: pose.inverse().apply(world + self.random.normal(scale=0.01, size=world.shape))
            for name, pose in TRUTH.items()
        }
        self.snapshot = made_snapshot(self.points)
        self.features_of: dict[str, FeatureCloud] = {}
        self.registrations: dict[tuple[str, str], PairRegistration] = {}
        self.decisions: list[MergeDecision] = []
        self.ground_plane: GroundPlane | None = None

    @property
    def refused(self) -> set[str]:
        return {"complete": set(), "uncertain": set(), "partial": {UNPLACED}, "failed": {*LIDARS} - {TARGET}}[
            self.outcome
        ]

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

    def search(self, stages):
        for pair in self.pairs():
            for stage in stages:
                yield from getattr(self, stage)(*pair)
        if "fine" in stages:
            yield from (events.VerdictChanged(each) for each in self.registrations.values() if each.verdict.reasons)
            yield events.SearchWidened(tuple(self.pairs()[-1:]), 0.5)
            yield events.LoopRegistered(self._registration(*self.pairs()[0], hypothesis=-1, refused=True))

    def correspond(self, target: str, source: str):
        yield events.CorrespondencesMatched(self._matches(target, source))

    def _matches(self, target: str, source: str) -> Correspondences:
        """Every fourth match is right."""
        to, of = self.features_of[target], self.features_of[source]
        count = 80
        rows = np.arange(count)
        wrong = (rows * 37 + 11) % len(of.points_m)
        at = np.where(rows % 4 == 0, rows, wrong)
        points = to.points_m[rows], of.points_m[at], to.normals[rows], of.normals[at]
        return Correspondences(target, source, *points, rows / count, rows, at)

    def coarse(self, target: str, source: str):
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

    def verify(self, target: str, source: str):
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

    def fine(self, target: str, source: str):
        if not self._coarse_result(target, source, 80).hypotheses:
            return
        # The pipeline registers the sparser cloud against the denser one, in either order of matching.
        swap = (target, source) == self.pairs()[0]
        pair = (source, target) if swap else (target, source)
        self.registrations[pair] = self._registration(*pair, hypothesis=0 if self.prior is None else 2)
        yield events.PairRegistered(self.registrations[pair])

    def _registration(self, target: str, source: str, hypothesis: int, *, refused: bool = False) -> PairRegistration:
        refused = refused or bool(self.refused & {target, source})
        fitness = 0.1 if refused else 0.8
        best, other = registrations = self._registrations(target, source, hypothesis)
        lead = best.evidence - other.evidence
        doubts = (
            Reason("too_little_evidence", 1.2, 2.3, "only 12 points lie on walls (evidence 1.2, limit 2.3)"),
            Reason("ambiguous", lead, 4.6, f"a pose 3.00 m and 180 deg away fits as well ({lead:.1f})", other),
            Reason("not_observable", 0.26, 0.15, "the scene does not constrain y (0.26 m away, limit 0.15 m)"),
        )
        steps = tuple(
            GicpStep(3 * (k + 1), 2.0 / (k + 1), 100 + k, 0.1 * k, 10.0 / (k + 1), 0.1 / (k + 1), 0.01)
            for k in range(4)
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
            verdict=Verdict("reject", doubts) if refused else self._verdict(target, source),
        )

    def _verdict(self, target: str, source: str) -> Verdict:
        if self.outcome == "uncertain" and UNPLACED in (target, source):
            return Verdict("uncertain", (IMPRECISE,))
        return Verdict("accept")

    def _registrations(self, target: str, source: str, hypothesis: int) -> tuple[Registration, ...]:
        solver = "cliques" if hypothesis >= 0 else ""
        origin = PRIOR if self.prior is not None and solver else solver
        truth = self.truth(target, source)
        turned = RigidTransform.from_xyz_rpy(target, target, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi)) @ truth
        first = self._assessment(source, 0, Hypothesis(truth, np.zeros(0), 0.0, origin))
        second = self._assessment(source, 1, Hypothesis(turned, np.zeros(0), 0.0, solver))
        return replace(first, hypothesis=hypothesis), second

    def merge(self):
        yield events.TargetChosen(TARGET, "set by --target")
        placed = [TARGET]
        for step, name in enumerate(sorted(set(LIDARS) - {TARGET} - self.refused)):
            if step:
                yield events.GroupsRegistered(self._registration(TARGET, name, hypothesis=-1))
            placed.append(name)
            verdict = self._verdict(TARGET, name)
            chosen = MergeCandidate(
                TARGET, name, 0.8, 0.06, verdict.accepted, 9.5, verdict.text, uncertain=not verdict.accepted
            )
            yield self._merge_step(step, chosen, placed)
        if self.refused:
            yield self._merge_step(len(self.decisions), None, placed)

    def _merge_step(self, step: int, chosen: MergeCandidate | None, placed: list[str]) -> events.MergeStepTaken:
        left = sorted(set(LIDARS) - set(placed))
        refused = {"passes": False, "evidence": -1.2, "reason": "too little evidence"}
        others = tuple(MergeCandidate(TARGET, name, 0.1, np.inf, **refused) for name in left)
        pairs = (*((chosen,) if chosen else ()), *others)
        reason = f"merged {chosen.source} into top" if chosen else "stopped: the best has fitness 0.100, below 0.2"
        groups = (tuple(sorted(placed)), *((name,) for name in left))
        self.decisions.append(MergeDecision(step, pairs, chosen, reason, groups))
        poses = tuple(TRUTH[name] for name in sorted(placed)) if chosen else ()
        return events.MergeStepTaken(self.decisions[-1], poses)

    def refine(self):
        placed = tuple(pose for name, pose in TRUTH.items() if name not in self.refused)
        yield from (events.MovableFound(name, self.points[name][:12], 600) for name in LIDARS)
        yield events.RigRefined(
            Refinement.of((PairResidual(TARGET, LIDARS[0], 0.004, 0.02, 0.001, 0.01, 0.9),)), placed
        )
        yield from made_surfaces(self.points, self.registrations, sorted({*LIDARS} - self.refused))

    def ground(self):
        base = RigidTransform.from_xyz_rpy("base", TARGET, (0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
        figures = (base, 0.4, 120.0, 0.006, 0.0015, np.array([0.04, 0.03]))
        self.ground_plane = GroundPlane(np.array([0.0, 0.0, 1.0]), 2.0, *figures)
        yield events.GroundEstimated(self.ground_plane, "120 m2 of ground are seen")

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
            return LidarPlacement(name, "the target", "placed", T_target_source=TRUTH[name], fitness=1.0, rmse_m=0.0)
        if not merged:
            return LidarPlacement(name, "stopped early as asked")
        if name in self.refused:
            return LidarPlacement(name, "its best registration has fitness 0.100, below 0.2")
        pose, covariance = TRUTH[name], np.diag([1e-8, 1e-8, 4e-8, 1e-6, 4e-6, 9e-6])
        if self.outcome == "uncertain" and name == UNPLACED:
            covariance[3, 3] = IMPRECISE.value**2
            return LidarPlacement(name, IMPRECISE.text, "uncertain", pose, 0.8, 0.06, covariance)
        return LidarPlacement(name, "placed", "placed", pose, 0.8, 0.06, covariance)
