# SPDX-License-Identifier: Apache-2.0
"""The other pose of a pair, where two cannot be told apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration, Reason, Verdict
from multilica.sinks.failures import failures
from multilica.sinks.run_story import RunStory
from multilica.stages.symmetry import doubt_by_symmetry
from multilica.stages.witness import Witness, judge, prepare_witness
from multilica.testimony import Testimony

__all__ = ["rival_of"]


def rival_of(story: RunStory, registration: PairRegistration) -> Assessment | None:
    """The pose that makes the chosen one ambiguous; None if that is not the trouble.

    It is one of the pair's own, or the one that a symmetry of the scene, seen by another pair, takes the chosen one to,
    or, of a pair that was accepted, where another accepted pair puts the LiDAR that was left out for it. The latter
    two were never registered: their fitness, RMSE and curvature are NaN.
    """
    if registration.verdict.accepted:
        return _elsewhere(story, registration)
    doubt = next((reason for reason in registration.verdict.reasons if reason.code == "ambiguous"), None)
    if doubt is None or not registration.assessments:
        return None
    if _is_by_symmetry(doubt):
        return _turned(story, registration)
    best, *others = registration.assessments
    return next((one for one in others if np.isclose(max(0.0, one.evidence / best.evidence), doubt.value)), None)


def _is_by_symmetry(doubt: Reason) -> bool:
    """A pose of the pair's own has a share of the evidence, and a limit to that, above zero."""
    return doubt.limit == 0.0


def _elsewhere(story: RunStory, registration: PairRegistration) -> Assessment | None:
    pair = story.pair_of(registration)
    if story.result is None or all(place.placed for place in story.result.placements if place.lidar in pair):
        return None
    other = next((one.elsewhere for one in failures(story) if one.pair == pair and one.elsewhere is not None), None)
    bench = _Bench.of(story, registration)
    if other is None or bench is None:
        return None
    poses = {place.lidar: place.T_target_source for place in story.result.placements if place.T_target_source}
    fixed, witness = (next(name for name in one if name in poses) for one in (pair, other))
    found = story.registrations[other]
    T_witness_left = found.T_target_source if found.target == witness else found.T_target_source.inverse()
    T_fixed_left = poses[fixed].inverse() @ poses[witness] @ T_witness_left
    return bench.assess(T_fixed_left if registration.target == fixed else T_fixed_left.inverse())


def _turned(story: RunStory, registration: PairRegistration) -> Assessment | None:
    """Let the stage doubt the pair once more, and keep the pose that it could not exclude."""
    bench = _Bench.of(story, registration)
    if bench is None:
        return None
    trials: list[Assessment] = []

    def testify(pose: RigidTransform) -> Testimony:
        trials.append(bench.assess(pose))
        return trials[-1].testimony

    undoubted = replace(registration, verdict=Verdict("accept"))
    sides = {registration.target, registration.source}
    others = [each for each in story.registrations.values() if {each.target, each.source} != sides]
    doubted, *_ = doubt_by_symmetry([undoubted, *map(_unaccepted, others)], testify, bench.limits)
    return None if doubted.verdict.accepted else trials[-1]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """Where the beams of a pair's LiDARs judge poses that were never registered."""

    target: Witness
    source: Witness
    limits: VerifyConfig

    @classmethod
    def of(cls, story: RunStory, pair: PairRegistration) -> _Bench | None:
        """None where the story lacks a cloud."""
        if story.config is None or not {pair.target, pair.source} <= {*story.clouds}:
            return None
        limits = story.config.verify
        target, source = (prepare_witness(story.clouds[name], limits) for name in (pair.target, pair.source))
        return cls(target, source, limits)

    def assess(self, pose: RigidTransform) -> Assessment:
        """That pose of the source in the target, as a finalist would have it."""
        there, here = ([(RigidTransform.identity(one.lidar, one.lidar), one)] for one in (self.target, self.source))
        testimony = judge(there, here, pose, self.limits.final_tolerance_m, self.limits.final_tolerance_deg)
        unknown = np.nan
        probes_m, target_probes_m = self.source.probes_m, self.target.probes_m
        return Assessment(-1, pose, testimony, unknown, unknown, unknown, probes_m, target_probes_m=target_probes_m)


def _unaccepted(pair: PairRegistration) -> PairRegistration:
    """So that it is only asked for the symmetries that it sees."""
    return replace(pair, verdict=Verdict("undecided")) if pair.verdict.accepted else pair
