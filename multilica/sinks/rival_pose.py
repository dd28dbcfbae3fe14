# SPDX-License-Identifier: Apache-2.0
"""The other pose of a pair, where two cannot be told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration, Reason, Verdict
from multilica.sinks.run_story import RunStory
from multilica.stages.symmetry import doubt_by_symmetry
from multilica.stages.witness import judge, prepare_witness
from multilica.testimony import Testimony

__all__ = ["rival_of"]


def rival_of(story: RunStory, registration: PairRegistration) -> Assessment | None:
    """The pose that makes the chosen one ambiguous; None if that is not the trouble.

    It is one of the pair's own, or the one that a symmetry of the scene, seen by another pair, takes the chosen one to.
    The latter was never registered: its fitness, RMSE and curvature are NaN.
    """
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


def _turned(story: RunStory, registration: PairRegistration) -> Assessment | None:
    """Let the stage doubt the pair once more, and keep the pose that it could not exclude."""
    sides = (registration.target, registration.source)
    if story.config is None or not {*sides} <= {*story.clouds}:
        return None
    limits = story.config.verify
    witnesses = {name: prepare_witness(story.clouds[name], limits) for name in sides}
    trials: list[tuple[RigidTransform, Testimony]] = []

    def testify(pose: RigidTransform) -> Testimony:
        here, there = ([(RigidTransform.identity(name, name), witnesses[name])] for name in (pose.target, pose.source))
        testimony = judge(here, there, pose, limits.final_tolerance_m, limits.final_tolerance_deg)
        trials.append((pose, testimony))
        return testimony

    undoubted = replace(registration, verdict=Verdict("accept"))
    others = [each for each in story.registrations.values() if {each.target, each.source} != {*sides}]
    doubted, *_ = doubt_by_symmetry([undoubted, *(_unaccepted(each) for each in others)], testify, limits)
    if doubted.verdict.accepted:
        return None
    pose, testimony = trials[-1]
    probes_m, target_probes_m = (witnesses[name].probes_m for name in (registration.source, registration.target))
    return Assessment(-1, pose, testimony, np.nan, np.nan, np.nan, probes_m, target_probes_m=target_probes_m)


def _unaccepted(pair: PairRegistration) -> PairRegistration:
    """So that it is only asked for the symmetries that it sees."""
    return replace(pair, verdict=Verdict("undecided")) if pair.verdict.accepted else pair
