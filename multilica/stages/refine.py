# SPDX-License-Identifier: Apache-2.0
"""Joint refinement of all poses of a rig."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform, skew
from multilica.registration.poses import moved
from multilica.registration.sensor_biases import (
    BIAS_COUNT,
    RING_BIAS_COUNT,
    posterior,
    prior_sigmas,
    ring_sigmas,
)
from multilica.results import IndexArray, PairRegistration, PairResidual, Refinement, SensorBias, connected

_ITERATIONS = 20
# Converged when no pose moves by more, rad and m.
_EPSILON = 1e-8
# After smaller steps, rad and m, the prior of the biases stays.
_SETTLED = 1e-3
_POSE_FREEDOM = 6
# Metres, degrees, millionths and metres.
_DISPLAYED = np.array([1.0, np.rad2deg(1.0), 1e6, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class RefinedRig:
    """Poses of a rig after the joint refinement.

    Args:
        poses: per LiDAR ``T_root_lidar``, the root with the identity.
        covariances: per LiDAR other than the root (6, 6), order rotation (rad), translation (m) along the root's axes.
        repeatability: per LiDAR the (6, 6) part of it that random errors cause.
        refinement: residuals of the pairs before and after, with the biases of the LiDARs.
    """

    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    repeatability: Mapping[str, FloatArray]
    refinement: Refinement


def refine(
    root: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    config: RefineConfig,
) -> RefinedRig:
    """Optimise the pose graph over all accepted pairs, loops included (the paper's future work).

    Gauss-Newton on the pairs' residuals, each weighted with its information. The biases of each LiDAR in range,
    elevation, scale and incidence, and those of its rings, are unknowns that its pairs share, with a prior. A pair
    whose residual is much larger than its information allows, after the biases, loses its weight (Cauchy), so that one
    bad pair does not bend the rig.

    Args:
        root: the LiDAR whose pose is fixed.
        poses: initial ``T_root_lidar`` of every placed LiDAR.
        pairs: registrations, of one or more snapshots; those without `information` or with a LiDAR that is not placed
            are left out.
    """
    used_pairs = [pair for pair in pairs if pair.information is not None and pair.lidars <= set(poses)]
    free = sorted((set(poses) & connected(root, used_pairs)) - {root})
    if not free:
        return RefinedRig(dict(poses), {}, {}, Refinement.of())
    rings = _rings_of(used_pairs)
    sigmas = _bias_sigmas(rings, config)
    counts = [len(numbers) for numbers in rings.values()]
    state = _State(dict(poses), np.zeros(len(sigmas)), free, rings)
    before = [_offset(pair, state.poses) for pair in used_pairs]
    prior = None
    for _ in range(_ITERATIONS):
        equations = _normal_equations(used_pairs, state, config)
        known = posterior(
            equations.information,
            equations.gradient,
            state.biases,
            sigmas,
            equations.spread,
            equations.random_spread,
            counts,
            prior,
        )
        state = state.moved(known.step)
        longest = np.abs(known.step).max()
        if longest < _EPSILON:
            break
        prior = known.prior if longest < _SETTLED else None
    residuals = tuple(_residual_of(pair, start, state, config) for pair, start in zip(used_pairs, before, strict=True))
    blocks = {name: slice(6 * index, 6 * index + 6) for index, name in enumerate(free)}
    return RefinedRig(
        state.poses,
        {name: known.covariance[block, block] for name, block in blocks.items()},
        {name: known.repeatability[block, block] for name, block in blocks.items()},
        Refinement.of(residuals, _sensor_biases(state, known.bias_sigmas)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Information (N, N), gradient (N,) and covariance of the gradient of all poses, then all biases."""

    information: FloatArray
    gradient: FloatArray
    spread: FloatArray
    random_spread: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Poses and biases during the refinement.

    Args:
        biases: of each LiDAR of `rings`, then of the rings of each.
        free: LiDARs with a pose to find.
        rings: of each LiDAR with biases, the numbers of its rings.
    """

    poses: Mapping[str, RigidTransform]
    biases: FloatArray
    free: Sequence[str]
    rings: Mapping[str, IndexArray]

    def moved(self, step: FloatArray) -> "_State":
        after = dict(self.poses)
        for i, name in enumerate(self.free):
            after[name] = moved(self.poses[name], step[6 * i : 6 * i + 3], step[6 * i + 3 : 6 * i + 6])
        return replace(self, poses=after, biases=self.biases + step[6 * len(self.free) :])

    def bias_columns(self, pair: PairRegistration) -> IndexArray:
        """Return which of the biases are those of the pair."""
        if (found := pair.bias_information) is None:
            return np.empty(0, np.int64)
        names = [*self.rings]
        sides = (pair.target, found.target_rings), (pair.source, found.source_rings)
        of_lidars = [BIAS_COUNT * names.index(name) + np.arange(BIAS_COUNT) for name, _ in sides]
        of_rings = []
        for name, numbers in sides:
            before = sum(len(self.rings[other]) for other in names[: names.index(name)])
            rows = before + np.searchsorted(self.rings[name], numbers)
            starts = BIAS_COUNT * len(names) + RING_BIAS_COUNT * rows
            of_rings.append((starts[:, None] + np.arange(RING_BIAS_COUNT)).ravel())
        return np.concatenate([*of_lidars, *of_rings])


def _rings_of(pairs: Iterable[PairRegistration]) -> dict[str, IndexArray]:
    """Return the numbers of the rings of each LiDAR of which biases are estimated, by name."""
    found = defaultdict(list)
    for pair in pairs:
        if pair.bias_information is not None:
            found[pair.target].append(pair.bias_information.target_rings)
            found[pair.source].append(pair.bias_information.source_rings)
    return {name: np.unique(np.concatenate(found[name])) for name in sorted(found)}


def _bias_sigmas(rings: Mapping[str, IndexArray], config: RefineConfig) -> FloatArray:
    of_lidars = [prior_sigmas(name, config) for name in rings]
    of_rings = [ring_sigmas(sigmas, len(numbers)) for sigmas, numbers in zip(of_lidars, rings.values(), strict=True)]
    return np.concatenate([np.empty(0), *of_lidars, *of_rings])


def trusted_pairs(
    registrations: Iterable[PairRegistration], merges: Iterable[Sequence[PairRegistration]]
) -> list[PairRegistration]:
    """Select the accepted pairs of single LiDARs, with the merges of groups that no such pair connects.

    Args:
        merges: each as one registration between the groups, or as several between their members.
    """
    trusted = [pair for pair in registrations if pair.verdict.accepted]
    for merge in merges:
        if merge[0].source not in connected(merge[0].target, trusted):
            trusted += merge
    return trusted


def _offset(pair: PairRegistration, poses: Mapping[str, RigidTransform]) -> FloatArray:
    """Return the offset (6,) of the poses from the pair: rotation, translation along the target's axes."""
    return (poses[pair.target].inverse() @ poses[pair.source]).offset_from(pair.T_target_source)


def _residual_of(pair: PairRegistration, start: FloatArray, state: _State, config: RefineConfig) -> PairResidual:
    end, squared = _offset(pair, state.poses), _squared(pair, state)
    probability = float(chdtrc(_POSE_FREEDOM, squared))
    return PairResidual(
        pair.target, pair.source, *_sizes(start), *_sizes(end), _weight(squared, config), probability=probability
    )


def _squared(pair: PairRegistration, state: _State) -> float:
    """Return the squared Mahalanobis distance of the poses from the pair, by its covariance with biases and all."""
    offset = _offset(pair, state.poses)
    return float(offset @ pair.information @ offset)  # type: ignore[operator]


def _sizes(residual: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(residual[3:])), float(np.rad2deg(np.linalg.norm(residual[:3])))


def _weight(squared: float, config: RefineConfig) -> float:
    return 1.0 / (1.0 + squared / (_POSE_FREEDOM * config.outlier_sigma**2))


def _normal_equations(pairs: Sequence[PairRegistration], state: _State, config: RefineConfig) -> _Equations:
    """Sum over the pairs, each with its robust weight."""
    poses = 6 * len(state.free)
    size = poses + len(state.biases)
    total = _Equations(np.zeros((size, size)), np.zeros(size), np.zeros((size, size)), np.zeros((size, size)))
    snapshots = Counter((pair.target, pair.source) for pair in pairs)
    for pair in pairs:
        weight = _weight(_squared(pair, state), config)
        biases = state.bias_columns(pair)
        ends = zip((pair.target, pair.source), _jacobians(pair, state.poses), strict=True)
        moving = [(6 * state.free.index(name), block) for name, block in ends if name in state.free]
        columns = np.concatenate([*(start + np.arange(6) for start, _ in moving), poses + biases])
        jacobian = np.hstack([block for _, block in moving])
        own = _equations_of(pair, state.biases[biases], _offset(pair, state.poses), snapshots[pair.target, pair.source])
        square = np.ix_(columns, columns)
        total.information[square] += weight * _by_poses(own.information, jacobian)
        total.gradient[columns] += weight * np.concatenate([jacobian.T @ own.gradient[:6], own.gradient[6:]])
        total.spread[square] += weight**2 * _by_poses(own.spread, jacobian)
        total.random_spread[square] += weight**2 * _by_poses(own.random_spread, jacobian)
    return total


def _by_poses(matrix: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Turn a sum of products by the pair's pose and biases into one by the LiDARs' poses and the biases."""
    mixed = jacobian.T @ matrix[:6, 6:]
    return np.block([[jacobian.T @ matrix[:6, :6] @ jacobian, mixed], [mixed.T, matrix[6:, 6:]]])


def _equations_of(pair: PairRegistration, biases: FloatArray, offset: FloatArray, snapshots: int) -> _Equations:
    """Return those of one pair, of its pose and perhaps of the biases of target and source.

    Args:
        snapshots: that have the pair.
    """
    found = pair.bias_information
    if found is None:
        information = np.asarray(pair.information)
        return _Equations(information, information @ offset, information, information)
    gradient = found.gradient + found.information @ np.concatenate([offset, biases - found.biases])
    return _Equations(found.information, gradient, found.spread_among(snapshots), found.random_spread)


def _sensor_biases(state: _State, sigmas: FloatArray) -> tuple[SensorBias, ...]:
    biases = state.biases[: len(sigmas)].reshape(-1, BIAS_COUNT)
    return tuple(
        SensorBias(name, *np.column_stack([bias * _DISPLAYED, sigma * _DISPLAYED]).ravel().tolist())
        for name, bias, sigma in zip(state.rings, biases, sigmas.reshape(-1, BIAS_COUNT), strict=True)
    )


def _jacobians(pair: PairRegistration, poses: Mapping[str, RigidTransform]) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the residual by motions of the target and of the source along the root's axes."""
    target, source = poses[pair.target], poses[pair.source]
    to_target = target.rotation.T
    apart = skew(source.xyz_m - target.xyz_m)
    zero = np.zeros((3, 3))
    by_target = np.block([[-to_target, zero], [to_target @ apart, -to_target]])
    by_source = np.block([[to_target, zero], [zero, to_target]])
    return by_target, by_source
