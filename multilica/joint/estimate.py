# SPDX-License-Identifier: Apache-2.0
"""Where some registrations put every LiDAR that they reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairKey, PairRegistration
from multilica.stages.refine import RefinedRig, refine

__all__ = ["Estimate", "chained", "estimate_pairs", "estimate_poses"]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A pose with its covariance (6, 6): rotation (rad), translation (m), along the axes of the pose's target."""

    pose: RigidTransform
    covariance: FloatArray


def chained(root: str, edges: Sequence[PairRegistration]) -> dict[str, RigidTransform]:
    """``T_root_lidar`` of every LiDAR that a chain of registrations leads to, by those with the most evidence."""
    poses = {root: RigidTransform.identity(root, root)}
    ordered = sorted(edges, key=lambda edge: (-edge.evidence, edge.target, edge.source))
    while (
        edge := next((edge for edge in ordered if (edge.target in poses) != (edge.source in poses)), None)
    ) is not None:
        if edge.target in poses:
            poses[edge.source] = poses[edge.target] @ edge.T_target_source
        else:
            poses[edge.target] = poses[edge.source] @ edge.T_target_source.inverse()
    return poses


def estimate_poses(root: str, edges: Sequence[PairRegistration], config: RefineConfig) -> Mapping[str, Estimate]:
    """The rig by itself: per LiDAR other than the root that the registrations lead to, its pose in the root's frame."""
    return _estimates(refine(root, chained(root, edges), edges, config))


def estimate_pairs(edges: Sequence[PairRegistration], config: RefineConfig) -> Mapping[PairKey, Estimate]:
    """The same for every pair of LiDARs that the registrations link, directly or not, in name order."""
    found: dict[PairKey, Estimate] = {}
    rigs: list[RefinedRig] = []
    for root in sorted({name for edge in edges for name in (edge.target, edge.source)}):
        rigs.append(refine(root, _seen_from(root, rigs) or chained(root, edges), edges, config))
        found |= {(root, name): estimate for name, estimate in _estimates(rigs[-1]).items() if root < name}
    return found


def _seen_from(root: str, rigs: Sequence[RefinedRig]) -> dict[str, RigidTransform]:
    """The poses of a rig that holds the root, from which another refinement has nothing left to move."""
    rig = next((rig for rig in rigs if root in rig.poses), None)
    return {} if rig is None else {name: rig.poses[root].inverse() @ pose for name, pose in rig.poses.items()}


def _estimates(rig: RefinedRig) -> dict[str, Estimate]:
    return {name: Estimate(rig.poses[name], covariance) for name, covariance in rig.covariances.items()}
