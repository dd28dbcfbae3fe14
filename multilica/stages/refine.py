# SPDX-License-Identifier: Apache-2.0
"""Adjust all poses of a rig to all its accepted pairs at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform, skew
from multilica.results import EdgeResidual, PairRegistration, Refinement

__all__ = ["RefinedRig", "linked", "refine"]


@dataclass(frozen=True, slots=True, eq=False)
class RefinedRig:
    """Poses after the adjustment.

    Args:
        poses: per LiDAR ``T_root_lidar``, the root with the identity.
        covariances: per LiDAR other than the root (6, 6), order rotation (rad), translation (m) along the root's axes.
        refinement: residuals of the pairs before and after.
    """

    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    refinement: Refinement


def refine(
    root: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    config: RefineConfig,
    snapshots: Sequence[str] = (),
) -> RefinedRig:
    """Pose graph over all accepted pairs, loops included (the paper's future work).

    Gauss-Newton on the pairs' disagreement with the poses, each weighted with its information; a pair that disagrees
    by much more than its information allows loses its weight (Cauchy), so that one bad pair does not bend the rig.

    Args:
        root: the LiDAR that stays where it is.
        poses: where to start, ``T_root_lidar`` of every placed LiDAR.
        pairs: registrations with `information`; those of LiDARs that are not placed are left out.
        snapshots: the one that each pair is from, whose scans have noise of their own; all from one if empty.
    """
    told = [
        (pair, snapshot)
        for pair, snapshot in zip(pairs, snapshots or [""] * len(pairs), strict=True)
        if pair.information is not None and {pair.target, pair.source} <= set(poses)
    ]
    edges = [edge for edge, _ in told]
    free = [name for name in sorted(poses) if name != root]
    free = [name for name in free if name in linked(root, edges)]
    current = dict(poses)
    if not free:
        return RefinedRig(current, {}, Refinement())
    before = [_disagreement(edge, current) for edge in edges]
    for _ in range(config.max_iterations):
        normal_matrix, gradient = _normal_equations(edges, current, free, config)
        step = np.asarray(-np.linalg.solve(normal_matrix, gradient), dtype=np.float64)
        current = _moved(current, free, step)
        if np.abs(step).max() < config.epsilon:
            break
    normal_matrix, _ = _normal_equations(_as_one_by_source(told), current, free, config)
    joint = np.asarray(np.linalg.inv(normal_matrix), dtype=np.float64)
    covariances = {name: joint[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i, name in enumerate(free)}
    after = [_disagreement(edge, current) for edge in edges]
    residuals = tuple(
        EdgeResidual(edge.target, edge.source, *_sizes(start), *_sizes(end), _weight(edge, end, config))
        for edge, start, end in zip(edges, before, after, strict=True)
    )
    return RefinedRig(current, covariances, Refinement(residuals))


def _as_one_by_source(told: Sequence[tuple[PairRegistration, str]]) -> list[PairRegistration]:
    """With their information shared out: the noise of a scan's points is the same in all pairs that it is source of."""
    count = Counter((edge.source, snapshot) for edge, snapshot in told)
    return [
        replace(edge, information=np.asarray(edge.information) / count[edge.source, snapshot])
        for edge, snapshot in told
    ]


def linked(root: str, edges: Sequence[PairRegistration]) -> set[str]:
    """The LiDARs that chains of pairs lead to from the root, itself included."""
    reached = {root}
    for _ in edges:
        for edge in edges:
            if {edge.target, edge.source} & reached:
                reached |= {edge.target, edge.source}
    return reached


def _disagreement(edge: PairRegistration, poses: Mapping[str, RigidTransform]) -> FloatArray:
    """(6,) by which the poses place the source otherwise than the pair: rotation, translation in the target's axes."""
    return (poses[edge.target].inverse() @ poses[edge.source]).offset_from(edge.T_target_source)


def _sizes(disagreement: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(disagreement[3:])), float(np.rad2deg(np.linalg.norm(disagreement[:3])))


def _weight(edge: PairRegistration, disagreement: FloatArray, config: RefineConfig) -> float:
    squared = float(disagreement @ edge.information @ disagreement)  # type: ignore[operator]
    return 1.0 / (1.0 + squared / (6.0 * config.outlier_sigma**2))


def _normal_equations(
    edges: Sequence[PairRegistration], poses: Mapping[str, RigidTransform], free: Sequence[str], config: RefineConfig
) -> tuple[FloatArray, FloatArray]:
    normal_matrix, gradient = np.zeros((6 * len(free), 6 * len(free))), np.zeros(6 * len(free))
    for edge in edges:
        error = _disagreement(edge, poses)
        information = edge.information * _weight(edge, error, config)  # type: ignore[operator]
        jacobian = np.zeros((6, 6 * len(free)))
        for name, block in zip((edge.target, edge.source), _jacobians(edge, poses), strict=True):
            if name in free:
                start = 6 * free.index(name)
                jacobian[:, start : start + 6] = block
        normal_matrix += jacobian.T @ information @ jacobian
        gradient += jacobian.T @ information @ error
    return normal_matrix, gradient


def _jacobians(edge: PairRegistration, poses: Mapping[str, RigidTransform]) -> tuple[FloatArray, FloatArray]:
    """Of the disagreement, by a turn and shift along the root's axes of the target's and of the source's pose."""
    target, source = poses[edge.target], poses[edge.source]
    to_target = target.rotation.T
    apart = skew(source.xyz_m - target.xyz_m)
    zero = np.zeros((3, 3))
    by_target = np.block([[-to_target, zero], [to_target @ apart, -to_target]])
    by_source = np.block([[to_target, zero], [zero, to_target]])
    return by_target, by_source


def _moved(poses: Mapping[str, RigidTransform], free: Sequence[str], step: FloatArray) -> dict[str, RigidTransform]:
    moved = dict(poses)
    for i, name in enumerate(free):
        turn, shift = step[6 * i : 6 * i + 3], step[6 * i + 3 : 6 * i + 6]
        pose = poses[name]
        rotation = Rotation.from_rotvec(turn).as_matrix() @ pose.rotation
        moved[name] = RigidTransform.from_rotation_translation(pose.target, pose.source, rotation, pose.xyz_m + shift)
    return moved
