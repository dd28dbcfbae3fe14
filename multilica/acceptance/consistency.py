# SPDX-License-Identifier: Apache-2.0
"""Cycles of accepted pairs that do not close within their covariances."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from multilica.acceptance.pair_graph import PairGraph
from multilica.config import AcceptanceConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairRegistration, PairResidual, Reason, connected

# A wider sigma covers both poses up to 5 cm and 0.5 degrees by default. Cycles of real LiDARs missed by 3 cm, as their
# errors are more than those that the covariances know; objects that moved between the scans make cycles miss by more.
_COVERED = 2.5
# Pairs of a single cycle differ in their probability by the robust weights only.
_AS_PROBABLE = 10.0


def doubted_lidars(
    target: str, pairs: Sequence[PairRegistration], residuals: Sequence[PairResidual]
) -> dict[str, PairResidual]:
    """Find the LiDARs whose poses hang on a cycle that does not close, each with the least probable residual.

    A pair that contradicts the others (chi squared, 6 degrees of freedom) says that one pair of its cycle is wrong, not
    which one: the robust weight of the refinement follows the majority, which may be what moved between the scans. So
    all LiDARs of the cycle are in doubt, and those that only they link to the target.

    Args:
        target: is never in doubt: the poses are relative to it.
        pairs: with which the poses were refined, one per residual.
    """
    found: dict[str, PairResidual] = {}
    names = sorted({name for pair in pairs for name in pair.lidars})
    for residual in sorted(residuals, key=lambda each: each.probability):
        if not residual.contradicts:
            break
        ends = {residual.target, residual.source}
        others = [pair for pair in pairs if pair.lidars != ends]
        cycle = {*PairGraph.of(names, others).lidars_between(residual.target, residual.source), *ends} - {target}
        linked = connected(target, [pair for pair in pairs if not pair.lidars & cycle])
        for name in names:
            if name not in linked:
                found.setdefault(name, residual)
    return found


def most_contradicting(residuals: Iterable[PairResidual]) -> PairResidual:
    """Return the least probable pair; of pairs of a single cycle, which are as probable, that with the least weight."""
    found = [*residuals]
    least = min(each.probability for each in found)
    return min((each for each in found if each.probability <= _AS_PROBABLE * least), key=lambda each: each.weight)


def outlier(
    pairs: Sequence[PairRegistration],
    residuals: Sequence[PairResidual],
    refined_without: Callable[[Sequence[PairRegistration]], Sequence[PairResidual]],
) -> PairResidual | None:
    """Find a pair that is the wrong one of its cycle: all others agree without it, and tell its pose twice.

    Args:
        pairs: with which the poses were refined, one per residual.
        refined_without: returns the residuals of some of the pairs, refined alone.

    Returns:
        The residual of that pair; None if nothing tells which pair is wrong.
    """
    worst = most_contradicting(residuals)
    ends = {worst.target, worst.source}
    others = [pair for pair in pairs if pair.lidars != ends]
    spared = [[pair for pair in others if pair is not one] for one in others]
    if not all(worst.source in connected(worst.target, left) for left in (others, *spared)):
        return None
    return None if any(each.contradicts for each in refined_without(others)) else worst


def is_beyond(residual: PairResidual, config: AcceptanceConfig) -> bool:
    """Return whether a pair differs by more than a wider sigma may cover."""
    return residual.apart_m > _COVERED * config.max_sigma_m or residual.apart_deg > _COVERED * config.max_sigma_deg


def widened(
    covariances: Mapping[str, FloatArray], doubts: Mapping[str, PairResidual], poses: Mapping[str, RigidTransform]
) -> dict[str, FloatArray]:
    """Widen the covariances (6, 6) of LiDARs in doubt by how far the pair is off, in all directions.

    They cover either pose: a turn of the pair moves what hangs on it by its lever.

    Args:
        poses: ``T_root_lidar`` of all these LiDARs.
    """
    found = dict(covariances)
    for name in doubts.keys() & covariances.keys():
        found[name] = covariances[name] + _spread(doubts[name], _lever_m(poses[name], doubts[name], poses))
    return found


def widened_by_snapshots(
    pose: RigidTransform,
    covariance: FloatArray,
    doubts: Sequence[PairResidual | None],
    poses: Mapping[str, RigidTransform],
) -> FloatArray:
    """Widen the covariance (6, 6) of a pose that several snapshots tell by how far their cycles are off.

    A LiDAR that is off by its own errors is so in every snapshot: the deviations add up, each by the share of its
    snapshot.

    Args:
        doubts: per snapshot that tells the pose, its contradiction, if there is one.
        poses: ``T_root_lidar`` of all LiDARs.
    """
    spreads = [_spread(each, _lever_m(pose, each, poses)) for each in doubts if each is not None]
    deviations = sum((np.sqrt(np.diag(spread)) for spread in spreads), np.zeros(6)) / max(len(doubts), 1)
    return np.asarray(covariance + np.diag(deviations**2))


def contradiction_of(residual: PairResidual, config: AcceptanceConfig) -> Reason:
    """Return the reason to doubt all pairs of the cycle."""
    probability = max(residual.probability, 1e-300)
    text = (
        f"{residual.source} against {residual.target} contradicts the other pairs of its cycle by "
        f"{1000.0 * residual.apart_m:.0f} mm, {residual.apart_deg:.2f} deg (probability {probability:.0e})"
    )
    return Reason("cycle_contradicted", residual.apart_m, _COVERED * config.max_sigma_m, text)


def _lever_m(pose: RigidTransform, residual: PairResidual, poses: Mapping[str, RigidTransform]) -> float:
    """Return the distance of a LiDAR from the farther one of a pair."""
    return max(float(np.linalg.norm(pose.xyz_m - poses[end].xyz_m)) for end in (residual.target, residual.source))


def _spread(residual: PairResidual, lever_m: float) -> FloatArray:
    off_rad = np.deg2rad(residual.apart_deg)
    return np.diag(np.repeat([off_rad, np.hypot(residual.apart_m, off_rad * lever_m)], 3) ** 2)
