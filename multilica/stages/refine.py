# SPDX-License-Identifier: Apache-2.0
"""Joint refinement of all poses of a rig."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtrc

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.sensor_biases import (
    BIAS_COUNT,
    RING_BIAS_COUNT,
    distrust,
    distrust_of_chains,
    posterior,
    posterior_step,
    prior_sigmas,
    ring_sigmas,
)
from multilica.registration.view_poses import UNKNOWN, ViewPoses
from multilica.results import (
    IndexArray,
    LinkedStops,
    PairRegistration,
    PairResidual,
    Refinement,
    SensorBias,
    ViewPair,
    connected,
)

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
        stops: per linked stop the root LiDAR in its own frame at the first of these stops.
        stop_covariances: per linked stop other than the first (6, 6), as those of the LiDARs.
        links: residuals of the links between stops.
    """

    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    repeatability: Mapping[str, FloatArray]
    refinement: Refinement
    stops: Mapping[str, RigidTransform] = field(default_factory=dict)
    stop_covariances: Mapping[str, FloatArray] = field(default_factory=dict)
    links: tuple[PairResidual, ...] = ()


def refine(
    root: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    config: RefineConfig,
    linked: LinkedStops | None = None,
    at_stops: Sequence[str] = (),
) -> RefinedRig:
    """Optimise the pose graph over all accepted pairs, loops included (the paper's future work).

    Gauss-Newton on the pairs' residuals, each weighted with its information. The biases of each LiDAR in range,
    elevation, scale and incidence, and those of its rings, are unknowns that its pairs share, with a prior. A pair
    whose residual is much larger than its information allows, after the biases, loses its weight (Cauchy), so that one
    bad pair does not bend the rig.

    Links between stops add the poses of the vehicle at these stops: the pose of a view is that of the vehicle times
    that of its LiDAR. For pairs within a stop it cancels.

    Args:
        root: the LiDAR whose pose is fixed.
        poses: initial ``T_root_lidar`` of every placed LiDAR.
        pairs: registrations, of one or more snapshots; those without `information`, with a LiDAR that is not placed, or
            apart from the root are left out.
        at_stops: the stop of each pair; empty: they are of snapshots that no link connects.
        linked: links between stops with initial poses; links are left out like pairs. They and the pairs determine the
            poses of all LiDARs.
    """
    linked = linked or LinkedStops()
    within = [ViewPair(pair, stop, stop) for pair, stop in zip(pairs, at_stops or [""] * len(pairs), strict=True)]
    known = [
        each for each in within if each.registration.information is not None and each.registration.lidars <= set(poses)
    ]
    links = [
        link
        for link in linked.links
        if link.registration.information is not None and link.registration.lidars <= set(poses)
    ]
    joined = set(poses) if links else set(poses) & connected(root, [each.registration for each in known])
    used_within = [each for each in known if each.registration.lidars <= joined]
    used = [*used_within, *links]
    free = sorted(joined - {root})
    stops = {name: linked.poses[name] for link in links for name in sorted(link.stops)}
    free_stops = sorted(stops.keys() - linked.first)
    if not free and not free_stops:
        return RefinedRig(dict(poses), {}, {}, Refinement.of())
    rings = _rings_of(each.registration for each in used)
    sigmas = _bias_sigmas(rings, config)
    counts = [len(numbers) for numbers in rings.values()]
    state = _State(ViewPoses(dict(poses), stops, free, free_stops, linked.groups()), np.zeros(len(sigmas)), rings)
    before = [state.views.offset(pair) for pair in used]
    # Linked stops show one place.
    scenes = [
        max(1, _snapshots_of(name, [each.registration for each in used_within]) - len(free_stops)) for name in free
    ] + [1] * len(free_stops)
    prior = None
    for _ in range(_ITERATIONS):
        information, gradient = _normal_equations(used, state, config)
        step, prior = posterior_step(information, gradient, state.biases, sigmas, counts, prior)
        end, state = state, state.moved(step)
        longest = np.abs(step).max()
        if longest < _EPSILON:
            break
        if longest >= _SETTLED:
            prior = None
    spreads = _spreads(used, end, config)
    told = posterior(information, gradient, end.biases, sigmas, *spreads, counts, prior, scenes=scenes)
    apart = _apart_from_others(used, state.views, [_weight(_squared(pair, state), config) for pair in used])
    residuals = tuple(
        _residual_of(pair, start, off, state, config) for pair, start, off in zip(used, before, apart, strict=True)
    )
    blocks = {name: slice(6 * index, 6 * index + 6) for index, name in enumerate(free)}
    of_stops = {name: slice(6 * index, 6 * index + 6) for index, name in enumerate(free_stops, start=len(free))}
    own = {name: state.distrust(name, sigmas) for name in (root, *free)}
    factors = own | distrust_of_chains(root, own, [each.registration.lidars for each in used])
    return RefinedRig(
        state.views.poses,
        {name: factors[name] ** 2 * told.covariance[block, block] for name, block in blocks.items()},
        {name: told.repeatability[block, block] for name, block in blocks.items()},
        Refinement.of(residuals[: len(used_within)], _sensor_biases(state, told.bias_sigmas)),
        state.views.stops,
        {name: told.covariance[block, block] for name, block in of_stops.items()},
        residuals[len(used_within) :],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Poses and biases during the refinement.

    Args:
        biases: of each LiDAR of `rings`, then of the rings of each.
        rings: of each LiDAR with biases, the numbers of its rings.
    """

    views: ViewPoses
    biases: FloatArray
    rings: Mapping[str, IndexArray]

    def moved(self, step: FloatArray) -> "_State":
        of_poses = self.views.columns
        return replace(self, views=self.views.moved(step[:of_poses]), biases=self.biases + step[of_poses:])

    def distrust(self, lidar: str, sigmas: FloatArray) -> float:
        """Return `distrust` of a LiDAR, from the standard deviations of all biases; 1 if none of its are estimated."""
        if lidar not in self.rings:
            return 1.0
        first = BIAS_COUNT * [*self.rings].index(lidar)
        own = slice(first, first + BIAS_COUNT)
        return distrust(self.biases[own], sigmas[own])

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


@dataclass(frozen=True, slots=True, eq=False)
class _Apart:
    """Offset (6,) of a pair from where the others put it, and its squared Mahalanobis distance."""

    offset: FloatArray
    squared: float


def _apart_from_others(pairs: Sequence[ViewPair], views: ViewPoses, weights: Sequence[float]) -> Iterator[_Apart]:
    """Compare each pair with the poses that the others give without it (leave one out).

    In a cycle, the refinement has moved the poses towards every pair: one of n equal pairs that is off by d has a
    residual of d / n, which says little. Against the others alone it is off by d, with the covariances of both. The
    biases that pairs share are in the covariance of each, as if they were independent.

    Args:
        weights: of the pairs, in the refinement.
    """
    size, unknown = views.columns, np.diag(UNKNOWN**-2.0)
    total, pull = np.diag(np.resize(UNKNOWN, size) ** -2.0), np.zeros(size)
    own = []
    for pair, weight in zip(pairs, weights, strict=True):
        jacobian, columns = views.jacobian(pair)
        weighted = weight * jacobian.T @ np.asarray(pair.registration.information)
        own.append((jacobian, columns, weighted @ jacobian, weighted @ views.offset(pair)))
        total[np.ix_(columns, columns)] += own[-1][2]
        pull[columns] += own[-1][3]
    for pair, (jacobian, columns, information, gradient) in zip(pairs, own, strict=True):
        others, right = total.copy(), np.zeros((size, 7))
        others[np.ix_(columns, columns)] -= information
        right[columns, 1:] = jacobian.T
        right[:, 0] = -pull
        right[columns, 0] += gradient
        moved = jacobian @ np.linalg.solve(others, right)[columns]
        offset = views.offset(pair) + moved[:, 0]
        covariance = moved[:, 1:] + np.linalg.inv(np.asarray(pair.registration.information) + unknown)
        yield _Apart(offset, float(offset @ np.linalg.solve(covariance, offset)))


def _residual_of(pair: ViewPair, start: FloatArray, apart: _Apart, state: _State, config: RefineConfig) -> PairResidual:
    end, weight = state.views.offset(pair), _weight(_squared(pair, state), config)
    probability = float(chdtrc(_POSE_FREEDOM, max(apart.squared, 0.0)))
    sizes = *_sizes(start), *_sizes(end)
    return PairResidual(pair.target.lidar, pair.source.lidar, *sizes, weight, probability, *_sizes(apart.offset))


def _squared(pair: ViewPair, state: _State) -> float:
    """Return the squared Mahalanobis distance of the poses from the pair, by its covariance with biases and all."""
    offset = state.views.offset(pair)
    return float(offset @ pair.registration.information @ offset)  # type: ignore[operator]


def _snapshots_of(lidar: str, pairs: Sequence[PairRegistration]) -> int:
    """Return the number of snapshots whose pairs show a LiDAR."""
    counts = Counter(pair.lidars for pair in pairs if lidar in pair.lidars)
    return max(counts.values(), default=1)


def _sizes(residual: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(residual[3:])), float(np.rad2deg(np.linalg.norm(residual[:3])))


def _weight(squared: float, config: RefineConfig) -> float:
    return 1.0 / (1.0 + squared / (_POSE_FREEDOM * config.outlier_sigma**2))


@dataclass(frozen=True, slots=True, eq=False)
class _Share:
    """A pair as a part of the sums over all poses and biases.

    Args:
        weight: robust.
        jacobian: (6, K) of the pair's pose by the poses of its views.
        columns: (K + B,) of those poses and of the pair's biases. A LiDAR that is registered with itself has its biases
            on both sides.
        snapshots: that have the pair.
    """

    pair: PairRegistration
    weight: float
    jacobian: FloatArray
    columns: IndexArray
    snapshots: int

    def gradient(self, state: _State, offset: FloatArray) -> FloatArray:
        """Return that of the poses and biases (K + B,)."""
        found = self.pair.bias_information
        if found is None:
            return np.asarray(self.jacobian.T @ np.asarray(self.pair.information) @ offset)
        biases = state.biases[state.bias_columns(self.pair)]
        own = found.gradient + found.information @ np.concatenate([offset, biases - found.biases])
        return np.concatenate([self.jacobian.T @ own[:6], own[6:]])

    def add(self, matrix: FloatArray, total: FloatArray, weight: float) -> None:
        """Add a matrix (6 + B, 6 + B) by the pair's pose and biases to that of all poses and biases."""
        mixed = self.jacobian.T @ matrix[:6, 6:]
        turned = np.block([[self.jacobian.T @ matrix[:6, :6] @ self.jacobian, mixed], [mixed.T, matrix[6:, 6:]]])
        columns, places = np.unique(self.columns, return_inverse=True)
        if len(columns) == len(self.columns):
            columns = self.columns
        else:
            sums = np.zeros((len(columns), len(self.columns)))
            sums[places, np.arange(len(self.columns))] = 1.0
            turned = sums @ turned @ sums.T
        total[np.ix_(columns, columns)] += weight * turned


def _shares(pairs: Sequence[ViewPair], state: _State, config: RefineConfig) -> Iterator[tuple[ViewPair, _Share]]:
    snapshots = Counter(pair.registration.lidars for pair in pairs if not pair.is_link)
    for pair in pairs:
        jacobian, moving = state.views.jacobian(pair)
        columns = np.concatenate([moving, state.views.columns + state.bias_columns(pair.registration)])
        times = 1 if pair.is_link else snapshots[pair.registration.lidars]
        yield pair, _Share(pair.registration, _weight(_squared(pair, state), config), jacobian, columns, times)


def _normal_equations(pairs: Sequence[ViewPair], state: _State, config: RefineConfig) -> tuple[FloatArray, FloatArray]:
    """Return information (N, N) and gradient (N,) of all poses, then all biases."""
    size = state.views.columns + len(state.biases)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    for pair, share in _shares(pairs, state, config):
        found = pair.registration.bias_information
        own = np.asarray(pair.registration.information) if found is None else found.information
        share.add(own, information, share.weight)
        np.add.at(gradient, share.columns, share.weight * share.gradient(state, state.views.offset(pair)))
    _hold_open(information, pairs, state)
    return information, gradient


def _spreads(pairs: Sequence[ViewPair], state: _State, config: RefineConfig) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (N, N) of the gradient, and the part of it that random errors cause.

    Systematic errors that pairs of the same LiDARs have in common add up.
    """
    size = state.views.columns + len(state.biases)
    spread, random = np.zeros((size, size)), np.zeros((size, size))
    for pair, share in _shares(pairs, state, config):
        found, squared = pair.registration.bias_information, share.weight**2
        own = np.asarray(pair.registration.information)
        of_random = own if found is None else found.random_spread
        of_all = own if found is None else found.spread_among(share.snapshots)
        share.add(of_all + _repeated(pair, pairs, state.views) * (of_all - of_random), spread, squared)
        share.add(of_random, random, squared)
    _hold_open(spread, pairs, state)
    _hold_open(random, pairs, state)
    return spread, random


def _repeated(pair: ViewPair, pairs: Sequence[ViewPair], views: ViewPoses) -> float:
    """Return how many other pairs repeat the systematic errors of one."""
    return sum(
        views.likeness(pair, each)
        for each in pairs
        if each is not pair and each.is_link == pair.is_link and each.registration.lidars == pair.registration.lidars
    )


def _hold_open(matrix: FloatArray, pairs: Sequence[ViewPair], state: _State) -> None:
    """Add a wide prior of the poses if there are links, which may leave some of them open."""
    if any(pair.is_link for pair in pairs):
        poses = np.arange(state.views.columns)
        matrix[poses, poses] += np.resize(UNKNOWN, len(poses)) ** -2.0


def _sensor_biases(state: _State, sigmas: FloatArray) -> tuple[SensorBias, ...]:
    biases = state.biases[: len(sigmas)].reshape(-1, BIAS_COUNT)
    return tuple(
        SensorBias(name, *np.column_stack([bias * _DISPLAYED, sigma * _DISPLAYED]).ravel().tolist())
        for name, bias, sigma in zip(state.rings, biases, sigmas.reshape(-1, BIAS_COUNT), strict=True)
    )
