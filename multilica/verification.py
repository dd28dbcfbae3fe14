# SPDX-License-Identifier: Apache-2.0
"""Test of known extrinsics against a snapshot, without a search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.acceptance.pair_graph import PairGraph
from multilica.config import CalibrationConfig
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration import clouds
from multilica.orchestration.pairs import register_sides, score_implied
from multilica.orchestration.state import CalibrationState
from multilica.results import Hypothesis, PairKey, PairRegistration, Registration
from multilica.snapshot import Snapshot
from multilica.stages.prior import require_usable
from multilica.stages.refine import refine
from multilica.workers import Workers

# Fewer points in common say nothing.
_MIN_COMMON = 100
# Verdicts on poses that stand alone.
_USABLE = ("accept", "uncertain")
# A pose near the known one is at least ten times as likely as one that a search comes upon.
_KNOWN_LOG_ODDS = 2.3


@dataclass(frozen=True, slots=True, eq=False)
class FoundRig:
    """Poses near the known ones that a snapshot supports.

    Args:
        root: the LiDAR that most others are linked to.
        poses: ``T_root_lidar`` of the LiDARs that registrations link to the root, the root included.
        covariances: (6, 6) per LiDAR but the root, order rotation (rad), translation (m) along the root's axes.
        reasons: why the other LiDARs have no pose.
        contradicted: of those, the LiDARs whose beams contradict their known pose; they have moved far.
    """

    root: str
    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    reasons: Mapping[str, str]
    contradicted: frozenset[str] = frozenset()


def register_from_known(
    snapshot: Snapshot,
    known: Extrinsics,
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
) -> FoundRig:
    """Register the LiDARs of a snapshot from their known poses.

    GICP and the fit to planes start at the known poses of pairs that see the same, those with the most common points
    first, until all LiDARs are linked. A LiDAR that moved by centimetres or degrees is followed to where it is now.

    Args:
        snapshot: at least two LiDARs with returns.
        known: poses of two or more of them, by name.
        config: the default preset if None.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, or the vehicle moves.
        UsageError: the poses lack two of the LiDARs.
    """
    config = config or CalibrationConfig()
    clouds.require_two_lidars(snapshot)
    require_usable(known, snapshot, config)
    state = CalibrationState(snapshot, config, observe, known, Workers())
    with threadpool_limits(1):
        clouds.preprocess_clouds(state)
        clouds.prepare_lidars(state, described=False)
        return _register(state, known)


def _register(state: CalibrationState, known: Extrinsics) -> FoundRig:
    names = sorted({*state.clouds} & known.members)
    poses = {pair: known.between(*pair) for pair in state.pairs if {*pair} <= {*names}}
    scores = dict(zip(poses, state.workers.map(score_implied, list(poses.values())), strict=True))
    found, accepted = list[PairRegistration](), list[PairRegistration]()
    for config in (state.config, _trusting(state.config)):
        for pair in _by_common_points(scores):
            if PairGraph.of(names, accepted).implied(*pair) is None:
                target, source = (state.lidars[name].side for name in pair)
                found.append(register_sides(target, source, [Hypothesis(poses[pair])], config))
                if found[-1].verdict.outcome in _USABLE and found[-1].information is not None:
                    accepted.append(found[-1])
    graph = PairGraph.of(names, accepted)
    root = max(names, key=lambda name: (len(graph.poses(name)), sum(name in pair.lidars for pair in accepted)))
    rig = refine(root, graph.poses(root), accepted, state.config.refine)
    lost = {name: _why(name, rig.poses, scores, found) for name in state.snapshot.names if name not in rig.poses}
    limit = state.config.acceptance.min_log_odds_margin
    contradicted = {
        name
        for pair, score in scores.items()
        for name in pair
        if name in lost and {*pair} - {name} <= {*rig.poses} and score.visibility.contradiction > limit
    }
    return FoundRig(root, rig.poses, rig.covariances, lost, frozenset(contradicted))


def _trusting(config: CalibrationConfig) -> CalibrationConfig:
    """Ask for less evidence, where pairs that have more do not link all LiDARs."""
    least = config.acceptance.min_evidence - _KNOWN_LOG_ODDS
    return config.model_copy(update={"acceptance": config.acceptance.model_copy(update={"min_evidence": least})})


def _by_common_points(scores: Mapping[PairKey, Registration]) -> list[PairKey]:
    """Order pairs by the points that both LiDARs see, agreeing or not: those of one that moved disagree."""
    common = {pair: score.visibility.agree + score.visibility.violate for pair, score in scores.items()}
    enough = [pair for pair in common if common[pair] >= _MIN_COMMON]
    return sorted(enough, key=lambda pair: (-common[pair], pair))


def _why(
    name: str,
    poses: Mapping[str, RigidTransform],
    scores: Mapping[PairKey, Registration],
    found: Sequence[PairRegistration],
) -> str:
    tried = [pair for pair in found if name in pair.lidars]
    if tried:
        best = max(tried, key=lambda pair: pair.evidence)
        (other,) = best.lidars - {name}
        return f"no pose near the known one fits {other}: {best.verdict.text or 'too few points match'}"
    if any(name in pair for pair in scores):
        return f"it sees too little of what {' and '.join(sorted(poses))} see"
    return "it has no returns in range, or no known pose"
