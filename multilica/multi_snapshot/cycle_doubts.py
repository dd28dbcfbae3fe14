# SPDX-License-Identifier: Apache-2.0
"""Cycles of pairs that do not close within snapshots, counted in the joint covariance."""

from collections.abc import Mapping, Sequence

from multilica.acceptance.consistency import contradiction_of, doubted_lidars, widened_by_snapshots
from multilica.config import AcceptanceConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import CalibrationResult, PairRegistration, PairResidual


def doubts_within(
    target: str, kept: Sequence[PairRegistration], result: CalibrationResult
) -> Mapping[str, PairResidual]:
    """Return, per LiDAR, the contradiction of a cycle of one snapshot on which its pose hangs.

    Args:
        kept: the registrations of the snapshot that count.
    """
    lidars = {pair.lidars for pair in kept}
    residuals = () if result.refinement is None else result.refinement.pairs
    return doubted_lidars(target, kept, [each for each in residuals if {each.target, each.source} in lidars])


def widened_by_doubts(
    pose: RigidTransform,
    covariance: FloatArray,
    doubts: Mapping[str, PairResidual | None],
    poses: Mapping[str, RigidTransform],
    limits: AcceptanceConfig,
) -> tuple[FloatArray, str]:
    """Widen the covariance (6, 6) of a joint pose by the cycles that do not close, and tell the worst of these.

    Args:
        doubts: per snapshot that tells the pose, the contradiction, if there is one.
        poses: ``T_root_lidar`` of all LiDARs with a pose.
    """
    known = {
        name: each if each is not None and {each.target, each.source} <= poses.keys() else None
        for name, each in doubts.items()
    }
    contradicting = {name: each for name, each in known.items() if each is not None}
    if not contradicting:
        return covariance, ""
    worst = min(contradicting, key=lambda name: contradicting[name].probability)
    text = f"in {worst} {contradiction_of(contradicting[worst], limits).text}"
    return widened_by_snapshots(pose, covariance, [*known.values()], poses), text
