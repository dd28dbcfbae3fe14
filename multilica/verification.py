# SPDX-License-Identifier: Apache-2.0
"""Test of known extrinsics against a snapshot, without a search."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.acceptance.pair_graph import PairGraph
from multilica.acceptance.placement import are_contradicted, place, unplaced_near_known
from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.orchestration import clouds
from multilica.orchestration.movable import doubt_movable
from multilica.orchestration.pairs import register_sides, score_implied
from multilica.orchestration.state import CalibrationState, deadline_of
from multilica.registration.poses import is_distinct
from multilica.results import (
    CalibrationResult,
    Hypothesis,
    LidarPlacement,
    PairKey,
    PairRegistration,
    Registration,
)
from multilica.snapshot import Snapshot
from multilica.stages.known_poses import require_usable_prior
from multilica.stages.refine import refine
from multilica.workers import Workers

# A pose near the known one is at least ten times as likely as one that a search finds.
_KNOWN_LOG_ODDS = 2.3


def register_from_known(
    snapshot: Snapshot,
    known: Extrinsics,
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    deadline_s: float | None = None,
) -> CalibrationResult:
    """Register the LiDARs of a snapshot from their known poses.

    The fit to planes starts at the known poses of pairs that see the same, those with the most common points first,
    until all LiDARs are linked. A LiDAR that moved by centimetres or degrees is followed by GICP to where it is now. If
    one seems to have moved, objects that did, or could have, are left out as in a calibration.

    Args:
        snapshot: at least two LiDARs with returns.
        known: poses of two or more of them, by name.
        config: the default preset if None.
        deadline_s: on `time.monotonic`, after which no pair is registered; by default `runtime.max_time_s` from now.

    Returns:
        A placement per LiDAR, relative to the LiDAR that most others are linked to.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, none of these has a known
            pose, or the vehicle moves.
        UsageError: the poses lack two of the LiDARs.
    """
    config = config or CalibrationConfig()
    clouds.require_two_lidars(snapshot)
    require_usable_prior(known, snapshot, config)
    deadline_s = deadline_of(config) if deadline_s is None else deadline_s
    state = CalibrationState(snapshot, config, observe, known, Workers(), deadline_s=deadline_s)
    with threadpool_limits(1):
        clouds.preprocess_clouds(state)
        clouds.prepare_lidars(state, described=False)
        return _register(state, known)


def _register(state: CalibrationState, known: Extrinsics) -> CalibrationResult:
    names = sorted({*state.clouds} & known.members)
    if not names:
        raise UnfitSnapshotError(
            f"{state.snapshot.source or 'The snapshot'} has no returns in range of the LiDARs with known poses "
            f"({', '.join(sorted({*state.snapshot.names} & known.members))}); check that these LiDARs measure."
        )
    linking = _Linking(state, known, names)
    scores = _scores(state, {pair: known.between(*pair) for pair in state.pairs if {*pair} <= {*names}})
    linking.link_from_known(scores)
    linking.link_beside_moved(list(scores))
    root, poses = linking.linked
    rig = refine(root, poses, linking.accepted, state.config.refine)
    covariances = state.slow_motion.added_to(rig.covariances, root)
    offsets = {name: rig.poses[name].offset_from(known.between(root, name)) for name in covariances}
    if offsets and are_contradicted(offsets, covariances):
        # It may have been a car that moved.
        state.target = root
        rig = doubt_movable(state, rig, linking.accepted)
        covariances = state.slow_motion.added_to(rig.covariances, root)
    limits = state.config.acceptance

    def placement(name: str) -> LidarPlacement:
        if name in rig.poses:
            return place(rig.poses[name], covariances.get(name), limits, held=state.held.get(name))
        beside = {pair: start for pair in scores if (start := _beside(pair, name, root, rig.poses, known))}
        found = linking.found
        return unplaced_near_known(name, rig.poses, _scores(state, beside), found, limits, state.not_reached)

    placements = tuple(map(placement, state.snapshot.names))
    return CalibrationResult(
        root, "most LiDARs are linked to it", placements, pairs=tuple(linking.found), time_limit=state.time_limit
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Linking:
    """The registrations so far.

    Args:
        names: of the LiDARs with a known pose.
        accepted: those of `found` that count.
    """

    state: CalibrationState
    known: Extrinsics
    names: Sequence[str]
    found: list[PairRegistration] = field(default_factory=list)
    accepted: list[PairRegistration] = field(default_factory=list)

    @property
    def linked(self) -> tuple[str, Mapping[str, RigidTransform]]:
        """The LiDAR that most others are linked to, with their poses relative to it."""
        graph = PairGraph.of(self.names, self.accepted)
        counts = Counter(name for pair in self.accepted for name in pair.lidars)
        root = max(self.names, key=lambda name: (len(graph.poses(name)), counts[name]))
        return root, graph.poses(root)

    def link_from_known(self, scores: Mapping[PairKey, Registration]) -> None:
        """Register pairs from their known poses until all LiDARs are linked, or the time is over."""
        attempts = [(config, pair) for config in self._configs for pair in _by_common_points(scores)]
        for number, (config, pair) in enumerate(attempts):
            graph = PairGraph.of(self.names, self.accepted)
            if graph.implied(*pair) is not None:
                continue
            if self.state.out_of_time:
                self._end_search({other for _, other in attempts[number:] if graph.implied(*other) is None})
                break
            self._register(self.known.between(*pair), config)

    def link_beside_moved(self, pairs: Sequence[PairKey]) -> None:
        """Register LiDARs that are not linked from where they should be beside those that moved."""
        for config, pair in product(self._configs, pairs):
            root, poses = self.linked
            if len(poses) == len(self.names):
                return
            for name in {*pair} - {*poses}:
                start = _beside(pair, name, root, poses, self.known)
                if start is None or not is_distinct(start, [self.known.between(start.target, name)]):
                    continue
                if self.state.out_of_time:
                    self._end_search({pair})
                elif _by_common_points(_scores(self.state, {pair: start})):
                    self._register(start, config)

    def _end_search(self, left: Collection[PairKey]) -> None:
        self.state.cut_short, self.state.not_reached = True, tuple(sorted({*self.state.not_reached, *left}))

    @property
    def _configs(self) -> tuple[CalibrationConfig, CalibrationConfig]:
        return self.state.config, _trusting(self.state.config)

    def _register(self, start: RigidTransform, config: CalibrationConfig) -> None:
        target, source = (self.state.lidars[name].side for name in (start.target, start.source))
        pair = register_sides(target, source, [Hypothesis(start)], config, is_known=True)
        self.found.append(pair)
        if pair.verdict.counts:
            self.accepted.append(pair)


def _beside(
    pair: PairKey, name: str, root: str, poses: Mapping[str, RigidTransform], known: Extrinsics
) -> RigidTransform | None:
    """Return the known pose of a LiDAR of a pair relative to where the other one is now.

    Args:
        poses: ``T_root_lidar`` of the linked LiDARs.

    Returns:
        None if the pair does not have the LiDAR, or the other one has no pose.
    """
    if name not in pair:
        return None
    (other,) = {*pair} - {name}
    return poses[other].inverse() @ known.between(root, name) if other in poses else None


def _scores(state: CalibrationState, poses: Mapping[PairKey, RigidTransform]) -> dict[PairKey, Registration]:
    return dict(zip(poses, state.workers.map(score_implied, list(poses.values())), strict=True))


def _trusting(config: CalibrationConfig) -> CalibrationConfig:
    """Ask for less evidence, where pairs that have more do not link all LiDARs."""
    least = config.acceptance.min_evidence - _KNOWN_LOG_ODDS
    return config.model_copy(update={"acceptance": config.acceptance.model_copy(update={"min_evidence": least})})


def _by_common_points(scores: Mapping[PairKey, Registration]) -> list[PairKey]:
    """Order pairs by the points that both LiDARs see, agreeing or not: those of one that moved disagree."""
    common = {pair: score.visibility.agree + score.visibility.violate for pair, score in scores.items()}
    enough = [pair for pair in common if common[pair] >= 100]  # fewer points in common say nothing
    return sorted(enough, key=lambda pair: (-common[pair], pair))
