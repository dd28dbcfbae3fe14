# SPDX-License-Identifier: Apache-2.0
"""Joint refinement of all poses of a rig."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform, skew
from multilica.registration.poses import moved
from multilica.results import PairRegistration, PairResidual, Refinement, connected

_ITERATIONS = 20
# Converged when no pose moves by more, rad and m.
_EPSILON = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class RefinedRig:
    """Poses of a rig after the joint refinement.

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
    """Optimise the pose graph over all accepted pairs, loops included (the paper's future work).

    Gauss-Newton on the pairs' residuals, each weighted with its information. A pair whose residual is much larger than
    its information allows loses its weight (Cauchy), so that one bad pair does not bend the rig.

    Args:
        root: the LiDAR whose pose is fixed.
        poses: initial ``T_root_lidar`` of every placed LiDAR.
        pairs: registrations; those without `information` or with a LiDAR that is not placed are left out.
        snapshots: name of the snapshot of each pair, since noise is shared within one; empty if there is only one.
    """
    used = [
        (pair, snapshot)
        for pair, snapshot in zip(pairs, snapshots or [""] * len(pairs), strict=True)
        if pair.information is not None and pair.lidars <= set(poses)
    ]
    used_pairs = [pair for pair, _ in used]
    free = sorted((set(poses) & connected(root, used_pairs)) - {root})
    current = dict(poses)
    if not free:
        return RefinedRig(current, {}, Refinement.of())
    before = [_residual(pair, current) for pair in used_pairs]
    for _ in range(_ITERATIONS):
        normal_matrix, gradient = _normal_equations(used_pairs, current, free, config)
        step = np.asarray(-np.linalg.solve(normal_matrix, gradient), dtype=np.float64)
        current = _move(current, free, step)
        if np.abs(step).max() < _EPSILON:
            break
    # The noise of a scan is the same in all pairs of which it is the source: they share its information.
    count = Counter((pair.source, snapshot) for pair, snapshot in used)
    shared = [
        replace(pair, information=np.asarray(pair.information) / count[pair.source, snapshot])
        for pair, snapshot in used
    ]
    normal_matrix, _ = _normal_equations(shared, current, free, config)
    joint = np.asarray(np.linalg.inv(normal_matrix), dtype=np.float64)
    covariances = {name: joint[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i, name in enumerate(free)}
    after = [_residual(pair, current) for pair in used_pairs]
    residuals = tuple(
        PairResidual(pair.target, pair.source, *_sizes(start), *_sizes(end), _weight(pair, end, config))
        for pair, start, end in zip(used_pairs, before, after, strict=True)
    )
    return RefinedRig(current, covariances, Refinement.of(residuals))


def trusted_pairs(
    registrations: Iterable[PairRegistration], merges: Iterable[PairRegistration]
) -> list[PairRegistration]:
    """Select the accepted pairs of single LiDARs, with the merges of groups that no such pair connects."""
    trusted = [pair for pair in registrations if pair.verdict.accepted]
    for merge in merges:
        if merge.source not in connected(merge.target, trusted):
            trusted.append(merge)
    return trusted


def _residual(pair: PairRegistration, poses: Mapping[str, RigidTransform]) -> FloatArray:
    """Return the offset (6,) of the poses from the pair: rotation, translation along the target's axes."""
    return (poses[pair.target].inverse() @ poses[pair.source]).offset_from(pair.T_target_source)


def _sizes(residual: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(residual[3:])), float(np.rad2deg(np.linalg.norm(residual[:3])))


def _weight(pair: PairRegistration, residual: FloatArray, config: RefineConfig) -> float:
    squared = float(residual @ pair.information @ residual)  # type: ignore[operator]
    return 1.0 / (1.0 + squared / (6.0 * config.outlier_sigma**2))


def _normal_equations(
    pairs: Sequence[PairRegistration], poses: Mapping[str, RigidTransform], free: Sequence[str], config: RefineConfig
) -> tuple[FloatArray, FloatArray]:
    normal_matrix, gradient = np.zeros((6 * len(free), 6 * len(free))), np.zeros(6 * len(free))
    for pair in pairs:
        residual = _residual(pair, poses)
        information = pair.information * _weight(pair, residual, config)  # type: ignore[operator]
        jacobian = np.zeros((6, 6 * len(free)))
        for name, block in zip((pair.target, pair.source), _jacobians(pair, poses), strict=True):
            if name in free:
                start = 6 * free.index(name)
                jacobian[:, start : start + 6] = block
        normal_matrix += jacobian.T @ information @ jacobian
        gradient += jacobian.T @ information @ residual
    return normal_matrix, gradient


def _jacobians(pair: PairRegistration, poses: Mapping[str, RigidTransform]) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the residual by motions of the target and of the source along the root's axes."""
    target, source = poses[pair.target], poses[pair.source]
    to_target = target.rotation.T
    apart = skew(source.xyz_m - target.xyz_m)
    zero = np.zeros((3, 3))
    by_target = np.block([[-to_target, zero], [to_target @ apart, -to_target]])
    by_source = np.block([[to_target, zero], [zero, to_target]])
    return by_target, by_source


def _move(poses: Mapping[str, RigidTransform], free: Sequence[str], step: FloatArray) -> dict[str, RigidTransform]:
    after = dict(poses)
    for i, name in enumerate(free):
        after[name] = moved(poses[name], step[6 * i : 6 * i + 3], step[6 * i + 3 : 6 * i + 6])
    return after
