# SPDX-License-Identifier: Apache-2.0
"""Snapshots that contradict each other on the pose of a pair."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot.estimate import Estimate, estimate_pairs, pair_poses
from multilica.registration.poses import is_distinct
from multilica.results import CalibrationResult, PairKey, PairRegistration, PoseConflict, Registration, connected

# All sets of so many snapshots are compared.
_MOST_COMPARED = 12

SnapshotPairs = Mapping[str, tuple[PairRegistration, ...]]
"""Per snapshot, the registrations that determine its poses."""
LeadAt = Callable[[str, Registration, RigidTransform], float]
"""Returns by how much a registered pose of two LiDARs is likelier than another one, by their beams at a stop."""


def excluded_poses(
    pairs: SnapshotPairs, results: Mapping[str, CalibrationResult], lead_at: LeadAt, config: CalibrationConfig
) -> tuple[PoseConflict, ...]:
    """Find the poses of pairs that stops which left the pair undecided exclude.

    A search that finds several poses has the true one among them, or this fits as well. So a pose of another stop that
    fits worse there is wrong: between equal houses, one stop may find only one of the wrong poses. Stops with the same
    pose outvote fewer that exclude it.

    If more stops found excluded poses of a pair than agree on another one, the place looks like another at these too.

    Args:
        results: of the same snapshots.
    """
    found: list[PoseConflict] = []
    for name, own in pairs.items():
        for pair in own:
            pose = pair.T_target_source
            same = [each for other in pairs.values() for each in other if _has_pose(each, pair)]
            against = {
                other: known.T_target_source
                for other, result in results.items()
                if (known := _undecided(pair, pairs[other], result)) and _excludes(other, known, pose, lead_at, config)
            }
            if against and len(against) >= len(same):
                distance_m, angle_rad = pose.distance_to(next(iter(against.values())).with_target(pair.target))
                lidars = (min(pair.lidars), max(pair.lidars))
                angle_deg = float(np.rad2deg(angle_rad))
                found.append(PoseConflict(name, lidars, tuple(against), distance_m, angle_deg, outvoted=True))
    return (*found, *_left_alone(pairs, found))


def _left_alone(pairs: SnapshotPairs, excluded: Sequence[PoseConflict]) -> Iterator[PoseConflict]:
    """Yield the poses of pairs that fewer snapshots have than found another one, which was excluded."""
    for name, own in pairs.items():
        for pair in own:
            wrong = [each.snapshot for each in excluded if {*each.lidars} == pair.lidars]
            same = [each for other in pairs.values() for each in other if _has_pose(each, pair)]
            if name in wrong or len(wrong) <= len(same):
                continue
            other = next(each for each in pairs[wrong[0]] if each.lidars == pair.lidars)
            distance_m, angle_rad = pair.T_target_source.distance_to(other.T_target_source.with_target(pair.target))
            lidars, angle_deg = (min(pair.lidars), max(pair.lidars)), float(np.rad2deg(angle_rad))
            yield PoseConflict(name, lidars, tuple(wrong), distance_m, angle_deg, outvoted=False)


def without_conflicts(pairs: SnapshotPairs, conflicts: Sequence[PoseConflict]) -> SnapshotPairs:
    """Drop the registrations that snapshots lose by conflicts.

    A snapshot that connects the LiDARs of a conflict only through others drops all registrations connected to them.
    """
    return {name: _without(own, [each for each in conflicts if each.snapshot == name]) for name, own in pairs.items()}


def resolve_conflicts(
    pairs: SnapshotPairs, config: CalibrationConfig
) -> tuple[SnapshotPairs, tuple[PoseConflict, ...]]:
    """Drop registrations until no two snapshots contradict each other, by majority if there is one.

    The snapshots that connect two LiDARs, directly or through others, vote on their pose. A snapshot that loses drops
    its registrations of that pair, as `without_conflicts` says; without a majority all contradicting snapshots drop
    theirs.
    """
    conflicts: tuple[PoseConflict, ...] = ()
    if not _differ(pairs, config):
        return pairs, ()
    estimates = {name: estimate_pairs(own, config.refine) for name, own in pairs.items()}
    while found := tuple(_conflicts(estimates, config)):
        conflicts += found
        left = without_conflicts(pairs, found)
        estimates |= {name: estimate_pairs(own, config.refine) for name, own in left.items() if own is not pairs[name]}
        pairs = left
    return pairs, conflicts


def inconsistent_lidars(conflicts: Sequence[PoseConflict], target: str) -> tuple[PoseConflict, ...]:
    """Return the fewest LiDARs that explain the conflicts of one snapshot, each as first LiDAR of a conflict.

    The LiDAR in the most conflicts is inconsistent first, the target last.
    """
    left, found = list(conflicts), []
    while left:
        counts = Counter(name for conflict in left for name in conflict.lidars)
        worst = min(counts, key=lambda name: (-counts[name], name == target, name))
        own = [conflict for conflict in left if worst in conflict.lidars]
        shown = min(own, key=lambda conflict: (target not in conflict.lidars, conflict.lidars))
        other = next(name for name in shown.lidars if name != worst)
        found.append(replace(shown, lidars=(worst, other)))
        left = [conflict for conflict in left if worst not in conflict.lidars]
    return tuple(found)


def _has_pose(pair: PairRegistration, other: PairRegistration) -> bool:
    if pair.lidars != other.lidars:
        return False
    return not is_distinct(pair.T_target_source.with_target(other.target), [other.T_target_source])


def _undecided(
    pair: PairRegistration, trusted: Sequence[PairRegistration], result: CalibrationResult
) -> PairRegistration | None:
    """Return the undecided registration of a pair that nothing else at its snapshot tells; None if there is none."""
    if pair.source in connected(pair.target, trusted):
        return None
    return next(
        (
            each
            for each in result.pairs
            if each.lidars == pair.lidars and each.verdict.outcome == "undecided" and each.registrations
        ),
        None,
    )


def _excludes(
    snapshot: str, known: PairRegistration, pose: RigidTransform, lead_at: LeadAt, config: CalibrationConfig
) -> bool:
    """Return whether a pose is none that the undecided pair found, and fits worse than its best one."""
    there = pose.with_target(known.target)
    if not is_distinct(there, [each.T_target_source for each in known.registrations]):
        return False
    return lead_at(snapshot, known.registrations[0], there) >= config.acceptance.min_log_odds_margin


def _differ(pairs: SnapshotPairs, config: CalibrationConfig) -> bool:
    """Return whether any two snapshots differ by enough to contradict each other, if their covariances are small."""
    poses: defaultdict[PairKey, list[RigidTransform]] = defaultdict(list)
    for own in pairs.values():
        for lidars, pose in pair_poses(own, config.refine).items():
            poses[lidars].append(pose)
    return any(_is_far(one, other, config) for own in poses.values() for one, other in combinations(own, 2))


def _conflicts(
    estimates: Mapping[str, Mapping[PairKey, Estimate]], config: CalibrationConfig
) -> Iterator[PoseConflict]:
    for lidars in sorted({pair for own in estimates.values() for pair in own}):
        yield from _vote(lidars, {name: own[lidars] for name, own in estimates.items() if lidars in own}, config)


def _vote(lidars: PairKey, voters: Mapping[str, Estimate], config: CalibrationConfig) -> Iterator[PoseConflict]:
    """Yield the losing snapshots; one whose covariance is too large to contradict another has no vote."""
    against: dict[str, list[str]] = {name: [] for name in voters}
    for one, other in combinations(voters, 2):
        if _contradict(voters[one], voters[other], config):
            against[one].append(other)
            against[other].append(one)
    disputing = [name for name in voters if against[name]]
    agreeing = _agreeing(disputing, against)
    outvoted = 2 * len(agreeing) > len(disputing)
    for name in disputing:
        if outvoted and name in agreeing:
            continue
        others = tuple(other for other in against[name] if other in agreeing or not outvoted)
        distance_m, angle_rad = voters[name].pose.distance_to(voters[others[0]].pose)
        yield PoseConflict(name, lidars, others, distance_m, float(np.rad2deg(angle_rad)), outvoted)


def _agreeing(disputing: Sequence[str], against: Mapping[str, Sequence[str]]) -> list[str]:
    """Return most of the snapshots that do not contradict each other; none if several sets have as many.

    If there are many, those with the fewest contradictions are taken first.
    """
    if len(disputing) > _MOST_COMPARED:
        agreeing: list[str] = []
        for name in sorted(disputing, key=lambda name: (len(against[name]), name)):
            if not {*against[name]} & {*agreeing}:
                agreeing.append(name)
        return agreeing
    for count in range(len(disputing), 0, -1):
        sets = [each for each in combinations(disputing, count) if not _any_contradict(each, against)]
        if sets:
            return [*sets[0]] if len(sets) == 1 else []
    return []


def _any_contradict(names: Sequence[str], against: Mapping[str, Sequence[str]]) -> bool:
    return any(other in names for name in names for other in against[name])


def _contradict(one: Estimate, other: Estimate, config: CalibrationConfig) -> bool:
    if not _is_far(one.pose, other.pose, config):
        return False
    offset = one.pose.offset_from(other.pose)
    squared = float(offset @ np.linalg.solve(one.covariance + other.covariance, offset))
    return squared > offset.size * config.refine.outlier_sigma**2


def _is_far(one: RigidTransform, other: RigidTransform, config: CalibrationConfig) -> bool:
    distance_m, angle_rad = one.distance_to(other)
    limits = config.joint
    return bool(distance_m > limits.max_disagreement_m or np.rad2deg(angle_rad) > limits.max_disagreement_deg)


def _without(pairs: tuple[PairRegistration, ...], conflicts: Sequence[PoseConflict]) -> tuple[PairRegistration, ...]:
    if not conflicts:
        return pairs
    disputed = {frozenset(conflict.lidars) for conflict in conflicts}
    kept = tuple(pair for pair in pairs if pair.lidars not in disputed)
    if len(kept) < len(pairs):
        return kept
    affected = {name for conflict in conflicts for name in connected(conflict.lidars[0], pairs)}
    return tuple(pair for pair in pairs if pair.target not in affected)
