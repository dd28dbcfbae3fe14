# SPDX-License-Identifier: Apache-2.0
"""Trial of a refusal: the true pose is registered by the stages that refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np

from multilica.acceptance.accept import accept
from multilica.config import CalibrationConfig
from multilica.events import CloudPreprocessed, Event, GroupsRegistered, LoopRegistered, PairRegistered, VerdictChanged
from multilica.extrinsics import Extrinsics
from multilica.registration.poses import is_distinct
from multilica.results import Hypothesis, PairRegistration, PreprocessedCloud
from multilica.stages.fine import register_best
from multilica.visibility.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.visibility.sensor_view import prepare_sensor_view

Members = tuple[str, ...]

# Points, hidden structure and distance are weighed against each other: each of them may cost a true pose most.
_KINDS = {
    "too_little_evidence": "too little in common",
    "structure_unexplained": "too little in common",
    "too_far_apart": "too little in common",
    "not_observable": "other poses explain as much",
    "imprecise": "other poses explain as much",
    "ambiguous": "other poses explain as much",
    "held_by_repetition": "other poses explain as much",
}
# The true pose puts nothing into empty space: refusing it for that is a fault of the stages.
_NEVER_TRUE = ("empty_space_violated",)


@dataclass(slots=True)
class Watch:
    """An observer that keeps what a trial needs."""

    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    registrations: list[PairRegistration] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        if isinstance(event, CloudPreprocessed) and len(event.cloud.points_m):
            self.clouds[event.cloud.lidar] = event.cloud
        elif isinstance(event, PairRegistered | VerdictChanged | GroupsRegistered | LoopRegistered):
            self.registrations.append(event.registration)

    def between(self, first: Members, second: Members) -> list[PairRegistration]:
        """Return the registrations between members of the two, in the order in which they were made."""
        return [
            each
            for each in self.registrations
            if (each.target in first and each.source in second) or (each.target in second and each.source in first)
        ]

    def refusal(self, first: Members, second: Members) -> tuple[str, ...]:
        """Return the codes of the reasons for which the two were not joined; none if no pose was found."""
        made = self.between(first, second)
        return made[-1].verdict.codes if made else ()


@dataclass(frozen=True, slots=True)
class Trial:
    """Verdict of the stages on a true pose.

    Args:
        accepted: the true pose would be merged if it were among the hypotheses.
        codes: the reasons why not.
    """

    accepted: bool
    codes: tuple[str, ...]


def is_borne_out(refused_for: Iterable[str], trial: Trial) -> bool:
    """Return whether the true pose is refused for the same kind of reason, or for any if no pose of the run fitted.

    If beams contradict the best pose that was found, none fitted, so it has little evidence as well.
    """
    codes = {*refused_for}
    kinds = set() if codes & {*_NEVER_TRUE} else _kinds(codes)
    true_kinds = _kinds(trial.codes)
    return not trial.accepted and bool(kinds & true_kinds if kinds else true_kinds)


def _kinds(codes: Iterable[str]) -> set[str]:
    return {_KINDS.get(code, code) for code in codes if code not in _NEVER_TRUE}


def try_truth(
    watch: Watch, groups: Sequence[Members], truth: Extrinsics, config: CalibrationConfig
) -> dict[str, Trial]:
    """Register the true poses between the groups that a run left unjoined.

    Args:
        groups: members of each, the target's first.

    Returns:
        Per LiDAR that is not in the first group, whether true poses would join it to that group, by way of other
        groups too; the reasons are those against its direct true pose.
    """
    trials = {pair: _try(watch, *pair, truth, config) for pair in combinations(groups, 2)}
    joined = {groups[0]}
    for _ in groups:
        joined |= {group for pair, trial in trials.items() if trial.accepted and joined & {*pair} for group in pair}
    return {lidar: Trial(group in joined, trials[groups[0], group].codes) for group in groups[1:] for lidar in group}


def _try(watch: Watch, first: Members, second: Members, truth: Extrinsics, config: CalibrationConfig) -> Trial:
    """Try the two groups as wholes; if that fails, their members pair by pair, as the stages do."""
    whole = _try_pose(watch, first, second, truth, config)
    if whole.accepted or len(first) == len(second) == 1:
        return whole
    pairs = (_try_pose(watch, (one,), (other,), truth, config) for one, other in product(first, second))
    return next((trial for trial in pairs if trial.accepted), whole)


def _try_pose(watch: Watch, first: Members, second: Members, truth: Extrinsics, config: CalibrationConfig) -> Trial:
    true_pose = truth.between(first[0], second[0])
    hypotheses = [Hypothesis(true_pose)]
    for made in watch.between(first, second):
        for scored in made.registrations:
            pose = scored.T_target_source
            pose = pose if pose.target in first else pose.inverse()
            root_pose = truth.between(first[0], pose.target) @ pose @ truth.between(pose.source, second[0])
            hypotheses.append(Hypothesis(root_pose))
    sides = (_side(watch, members, truth, config) for members in (first, second))
    best = register_best(*sides, hypotheses, config)
    verdict = accept(best.registrations, config.acceptance)
    pose = best.T_target_source.with_target(first[0])
    elsewhere = ("ambiguous",) if is_distinct(pose, [true_pose]) else ()
    codes = tuple(dict.fromkeys((*elsewhere, *verdict.codes)))
    return Trial(not codes, codes)


def _side(watch: Watch, members: Members, truth: Extrinsics, config: CalibrationConfig) -> RegistrationCloud:
    root = members[0]
    poses = {name: truth.between(root, name) for name in members}
    points_m = np.concatenate([pose.apply(watch.clouds[name].points_m) for name, pose in poses.items()])
    views = [(pose, prepare_sensor_view(watch.clouds[name])) for name, pose in poses.items()]
    return prepare_registration_cloud(root, points_m, views, config)
