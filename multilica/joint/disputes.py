# SPDX-License-Identifier: Apache-2.0
"""Which snapshots contradict each other on where two LiDARs sit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from multilica.config import CalibrationConfig
from multilica.joint.estimate import Estimate, estimate_pairs
from multilica.results import PairKey, PairRegistration
from multilica.stages.refine import linked

__all__ = ["Dispute", "Edges", "culprits", "settle"]

Edges = Mapping[str, tuple[PairRegistration, ...]]
"""Per snapshot, the registrations that its poses rest on."""


@dataclass(frozen=True, slots=True)
class Dispute:
    """One snapshot against others on one pair of LiDARs.

    Args:
        lidars: the pair, in name order.
        others: the snapshots that contradict it.
        distance_m, angle_deg: between its pose of the pair and that of the first of these.
        outvoted: whether more than half of the contradicting snapshots agree on another pose; if not, nobody knows who
            is right.
    """

    snapshot: str
    lidars: PairKey
    others: tuple[str, ...]
    distance_m: float
    angle_deg: float
    outvoted: bool


def settle(edges: Edges, config: CalibrationConfig) -> tuple[Edges, tuple[Dispute, ...]]:
    """Drop registrations until no two snapshots contradict each other, by majority where there is one.

    Every pair of LiDARs is put to the vote of the snapshots that link the two, directly or not. A snapshot that loses
    gives up its direct registrations of the pairs that it lost; all snapshots do where there is no majority. One that
    contradicts the others on pairs that it links indirectly only gives up all registrations that link those.
    """
    disputes: tuple[Dispute, ...] = ()
    while found := tuple(_disputes(edges, config)):
        disputes += found
        edges = {name: _without(own, [each for each in found if each.snapshot == name]) for name, own in edges.items()}
    return edges, disputes


def culprits(disputes: Sequence[Dispute], target: str) -> tuple[Dispute, ...]:
    """Fewest LiDARs that explain what one snapshot is disputed on, each with the dispute that shows it best.

    The first of a dispute's LiDARs is the one that is blamed: the one in the most disputes, the target last.
    """
    left, found = list(disputes), []
    while left:
        counts = Counter(name for dispute in left for name in dispute.lidars)
        worst = min(counts, key=lambda name: (-counts[name], name == target, name))
        own = [dispute for dispute in left if worst in dispute.lidars]
        shown = min(own, key=lambda dispute: (target not in dispute.lidars, dispute.lidars))
        other = next(name for name in shown.lidars if name != worst)
        found.append(_about((worst, other), shown))
        left = [dispute for dispute in left if worst not in dispute.lidars]
    return tuple(found)


def _about(lidars: PairKey, dispute: Dispute) -> Dispute:
    return Dispute(dispute.snapshot, lidars, dispute.others, dispute.distance_m, dispute.angle_deg, dispute.outvoted)


def _disputes(edges: Edges, config: CalibrationConfig) -> Iterator[Dispute]:
    estimates = {snapshot: estimate_pairs(own, config.refine) for snapshot, own in edges.items()}
    for lidars in sorted({pair for own in estimates.values() for pair in own}):
        yield from _vote(lidars, {name: own[lidars] for name, own in estimates.items() if lidars in own}, config)


def _vote(lidars: PairKey, voters: Mapping[str, Estimate], config: CalibrationConfig) -> Iterator[Dispute]:
    """Who loses; a snapshot whose pose is too unsure to contradict anyone makes no majority."""
    against: dict[str, list[str]] = {name: [] for name in voters}
    for one, other in combinations(voters, 2):
        if _contradict(voters[one], voters[other], config):
            against[one].append(other)
            against[other].append(one)
    disputing = [name for name in voters if against[name]]
    agreeing: list[str] = []
    for name in sorted(disputing, key=lambda name: len(against[name])):
        if not {*against[name]} & {*agreeing}:
            agreeing.append(name)
    outvoted = 2 * len(agreeing) > len(disputing)
    for name in disputing:
        if outvoted and name in agreeing:
            continue
        others = tuple(other for other in against[name] if other in agreeing or not outvoted)
        distance_m, angle_rad = voters[name].pose.distance_to(voters[others[0]].pose)
        yield Dispute(name, lidars, others, distance_m, float(np.rad2deg(angle_rad)), outvoted)


def _contradict(one: Estimate, other: Estimate, config: CalibrationConfig) -> bool:
    distance_m, angle_rad = one.pose.distance_to(other.pose)
    limits = config.joint
    if distance_m <= limits.max_disagreement_m and np.rad2deg(angle_rad) <= limits.max_disagreement_deg:
        return False
    offset = one.pose.offset_from(other.pose)
    squared = float(offset @ np.linalg.solve(one.covariance + other.covariance, offset))
    return squared > offset.size * config.refine.outlier_sigma**2


def _without(edges: tuple[PairRegistration, ...], disputes: Sequence[Dispute]) -> tuple[PairRegistration, ...]:
    if not disputes:
        return edges
    disputed = {frozenset(dispute.lidars) for dispute in disputes}
    kept = tuple(edge for edge in edges if frozenset((edge.target, edge.source)) not in disputed)
    if len(kept) < len(edges):
        return kept
    tainted = {name for dispute in disputes for name in linked(dispute.lidars[0], edges)}
    return tuple(edge for edge in edges if edge.target not in tainted)
