# SPDX-License-Identifier: Apache-2.0
"""Joint refinement of the rig, and the LiDARs that lose their pose in it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from multilica import events
from multilica.acceptance.consistency import contradiction_of, doubted_lidars, is_beyond, outlier, widened
from multilica.acceptance.rig import excluded_lidars, may_join
from multilica.geometry import RigidTransform
from multilica.orchestration.movable import doubt_movable
from multilica.orchestration.state import CalibrationState
from multilica.results import Group, MergeDecision, PairRegistration, PairResidual, Reason, Verdict, connected
from multilica.stages.refine import RefinedRig, refine, trusted_pairs


def refine_rig(state: CalibrationState) -> None:
    """Refine all poses jointly; LiDARs whose pairs contradict each other lose their pose, or have a wider covariance.

    A small contradiction is counted in the covariance. With a larger one no pose of the cycle can be trusted: the
    disagreement does not say how far the wrong pair is off. If the others tell which pair is wrong, that pair goes
    instead. With one frame, the others may agree on a car that moved between the scans.
    """
    if not state.config.refine.enabled or state.group is None:
        return
    limits = state.config.acceptance
    poses = _without_excluded(state, state.group.poses)
    watched = {lidar.name for lidar in state.snapshot.lidars if len(lidar.scans) > 1}

    def residuals_of(pairs: Sequence[PairRegistration]) -> tuple[PairResidual, ...]:
        return refine(state.target, poses, pairs, state.config.refine).refinement.pairs

    while True:
        used = _pairs_between(state, poses)
        rig = refine(state.target, poses, used, state.config.refine)
        doubts = doubted_lidars(state.target, used, rig.refinement.pairs)
        lost = {
            name: contradiction_of(residual, limits) for name, residual in doubts.items() if is_beyond(residual, limits)
        }
        if not lost:
            break
        if (wrong := outlier(used, rig.refinement.pairs, residuals_of)) and {wrong.target, wrong.source} <= watched:
            _doubt_pair(state, wrong)
            continue
        poses = _without(state, poses, lost)
    rig = doubt_movable(state, rig, used)
    state.group = Group(state.target, rig.poses)
    _take_covariances(state, rig, doubts)
    state.refinement = rig.refinement
    state.observe(events.RigRefined(rig.refinement, tuple(pose for _, pose in sorted(rig.poses.items()))))


def estimate_sigmas(state: CalibrationState) -> None:
    """Estimate the covariances of the merged poses where no joint refinement follows: those that it would give.

    Without verification there is none, as in the paper.
    """
    if state.group is None or not state.config.verify.enabled:
        return
    poses = state.group.poses
    used = _pairs_between(state, poses)
    rig = refine(state.target, poses, used, state.config.refine)
    _take_covariances(state, rig, doubted_lidars(state.target, used, rig.refinement.pairs))


def _take_covariances(state: CalibrationState, rig: RefinedRig, doubts: Mapping[str, PairResidual]) -> None:
    """Keep the covariances of a rig, wider for LiDARs in doubt, with the reasons for these."""
    limits = state.config.acceptance
    state.doubts = {name: contradiction_of(residual, limits).text for name, residual in doubts.items()}
    covariances = widened(rig.covariances, doubts, rig.poses)
    state.covariances = state.slow_motion.added_to(covariances, state.target)
    state.repeatability = state.slow_motion.added_to(rig.repeatability, state.target)


def _without_excluded(state: CalibrationState, poses: Mapping[str, RigidTransform]) -> Mapping[str, RigidTransform]:
    """Leave out LiDARs that undecided pairs exclude from where they are."""
    pairs = tuple(state.registrations.values())
    lost = excluded_lidars(state.target, poses, pairs, state.score_pose, state.config.acceptance)
    return _without(state, poses, lost) if lost else poses


def _without(
    state: CalibrationState, poses: Mapping[str, RigidTransform], lost: Mapping[str, Reason]
) -> Mapping[str, RigidTransform]:
    """Take the lost LiDARs out of the target's group, with those that only they join to it."""
    _doubt_pairs_of(state, lost)
    left = _rejoin(state, poses.keys() - lost.keys())
    _split_off(state, lost, poses.keys() - lost.keys() - left)
    return {name: pose for name, pose in poses.items() if name in left}


def _doubt_pair(state: CalibrationState, wrong: PairResidual) -> None:
    """Leave the pair undecided that contradicts the others."""
    reason, ends = contradiction_of(wrong, state.config.acceptance), {wrong.target, wrong.source}
    for key, pair in state.registrations.items():
        if pair.lidars == ends and may_join(pair):
            state.registrations[key] = replace(pair, verdict=Verdict("undecided", (reason,)))
            state.observe(events.VerdictChanged(state.registrations[key]))
    merges = (tuple(pair for pair in merge if pair.lidars != ends) for merge in state.merges)
    state.merges = [merge for merge in merges if merge]


def _doubt_pairs_of(state: CalibrationState, lost: Mapping[str, Reason]) -> None:
    """Leave the accepted and uncertain pairs of lost LiDARs undecided."""
    for key, pair in state.registrations.items():
        reasons = [lost[name] for name in sorted(pair.lidars & lost.keys())]
        if reasons and may_join(pair):
            state.registrations[key] = replace(pair, verdict=Verdict("undecided", (reasons[0],)))
            state.observe(events.VerdictChanged(state.registrations[key]))
    state.merges = [merge for merge in state.merges if not any(pair.lidars & lost.keys() for pair in merge)]


def _pairs_between(state: CalibrationState, names: Collection[str]) -> list[PairRegistration]:
    """Return the pairs that decide poses, between these LiDARs."""
    return [pair for pair in trusted_pairs(state.registrations.values(), state.merges) if pair.lidars <= {*names}]


def _rejoin(state: CalibrationState, names: Collection[str]) -> set[str]:
    """Join those of the LiDARs whose merge went with a lost one to the target by uncertain pairs, the likeliest first.

    Returns:
        The LiDARs that are joined now.
    """
    pairs = [pair for pair in state.registrations.values() if pair.lidars <= {*names}]
    uncertain = sorted((pair for pair in pairs if pair.verdict.outcome == "uncertain"), key=lambda pair: -pair.evidence)
    while True:
        joined = connected(state.target, _pairs_between(state, names))
        joining = next((pair for pair in uncertain if len(pair.lidars & joined) == 1), None)
        if joining is None:
            return joined
        state.merges.append((joining,))


def _split_off(state: CalibrationState, lost: Mapping[str, Reason], alone: Collection[str]) -> None:
    """Take LiDARs out of the target's group, each into a group of its own.

    Args:
        alone: LiDARs that no pair joins without the lost ones.
    """
    gone = {*lost, *alone}
    groups = [tuple(name for name in group if name not in gone) for group in state.decisions[-1].groups]
    groups = [*filter(None, groups), *((name,) for name in sorted(gone))]
    texts = sorted({reason.text for reason in lost.values()})
    reason = f"{', '.join(sorted(lost))} left the group: {'; '.join(texts)}"
    if alone:
        reason = f"{reason}; without {'these' if len(lost) > 1 else 'it'} nothing joins {', '.join(sorted(alone))}"
    decision = MergeDecision(len(state.decisions), (), None, reason, tuple(groups))
    state.decisions.append(decision)
    state.observe(events.MergeStepTaken(decision, ()))
