# SPDX-License-Identifier: Apache-2.0
"""Poses that the registrations of each snapshot determine, with their scatter over snapshots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from multilica.acceptance.pair_graph import PairGraph
from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairKey, PairRegistration, Spread
from multilica.results.placements import LEAST_PROBABILITY
from multilica.stages.refine import RefinedRig, refine


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A pose with its covariance (6, 6): rotation (rad), translation (m), along the axes of the pose's target."""

    pose: RigidTransform
    covariance: FloatArray


def chained(root: str, pairs: Sequence[PairRegistration]) -> dict[str, RigidTransform]:
    """Return ``T_root_lidar`` of every LiDAR connected to the root, by the registrations with the most evidence."""
    return PairGraph.of(sorted({root}.union(*(pair.lidars for pair in pairs))), pairs).poses(root)


def estimate_poses(root: str, pairs: Sequence[PairRegistration], config: RefineConfig) -> Mapping[str, Estimate]:
    """Estimate the pose of each LiDAR connected to the root, in the root's frame."""
    return _estimates(refine(root, chained(root, pairs), pairs, config))


def estimate_pairs(pairs: Sequence[PairRegistration], config: RefineConfig) -> Mapping[PairKey, Estimate]:
    """Estimate the pose of every pair of connected LiDARs, in name order."""
    found: dict[PairKey, Estimate] = {}
    rigs: list[RefinedRig] = []
    for root in sorted({name for pair in pairs for name in pair.lidars}):
        rigs.append(refine(root, _rooted_at(root, rigs) or chained(root, pairs), pairs, config))
        found |= {(root, name): estimate for name, estimate in _estimates(rigs[-1]).items() if root < name}
    return found


def pair_poses(pairs: Sequence[PairRegistration], config: RefineConfig) -> dict[PairKey, RigidTransform]:
    """Return the pose of every pair of connected LiDARs, in name order, as `estimate_pairs` without covariances."""
    found: dict[PairKey, RigidTransform] = {}
    left = {name for pair in pairs for name in pair.lidars}
    while left:
        root = min(left)
        poses = refine(root, chained(root, pairs), pairs, config).poses
        found |= {(one, other): poses[one].inverse() @ poses[other] for one, other in combinations(sorted(poses), 2)}
        left -= poses.keys()
    return found


def _rooted_at(root: str, rigs: Sequence[RefinedRig]) -> dict[str, RigidTransform]:
    """Return the poses of a refined rig with that root, so that refining it again changes nothing."""
    rig = next((rig for rig in rigs if root in rig.poses), None)
    return {} if rig is None else {name: rig.poses[root].inverse() @ pose for name, pose in rig.poses.items()}


def _estimates(rig: RefinedRig) -> dict[str, Estimate]:
    return {name: Estimate(rig.poses[name], covariance) for name, covariance in rig.covariances.items()}


def chance_of_difference(one: Estimate, other: Estimate) -> float:
    """Return the probability that estimates of one pose differ at least as much, by chi squared of both covariances."""
    offset = one.pose.offset_from(other.pose)
    squared = offset @ np.linalg.pinv(one.covariance + other.covariance, hermitian=True) @ offset
    return float(chdtrc(offset.size, squared))


def spread_of(estimates: Sequence[Estimate]) -> Spread:
    """Compute the sample standard deviations of one LiDAR's poses in several snapshots."""
    if len(estimates) < 2:
        return Spread(len(estimates))
    sigma = np.std(_offsets(estimates), axis=0, ddof=1)
    return Spread(len(estimates), tuple(sigma[3:].tolist()), tuple(np.rad2deg(sigma[:3]).tolist()))


def scatter_ratio(estimates: Sequence[Estimate]) -> FloatArray:
    """Compute the (6,) ratios of the measured scatter to that which the covariances predict.

    Per axis Birge's ratio (Phys. Rev. 40, 1932): the square root of chi squared per degree of freedom about the
    weighted mean. The standard error of the mean times this ratio agrees with the measured scatter. Unlike the plain
    standard error it lets a snapshot with a large covariance scatter accordingly. Every other set of snapshots scatters
    more than predicted. So the ratio is 1 unless the probability of chi squared is below `LEAST_PROBABILITY`.

    Poses may contradict each other in a direction between the axes, so the ratio of all six together counts as well.
    """
    freedom = len(estimates) - 1
    if freedom < 1:
        return np.ones(6)
    offsets, covariances = _offsets(estimates), np.array([estimate.covariance for estimate in estimates])
    weights = 1.0 / np.diagonal(covariances, axis1=1, axis2=2)
    mean = np.sum(weights * offsets, axis=0) / np.sum(weights, axis=0)
    of_axes = _birge(np.sum(weights * (offsets - mean) ** 2, axis=0), freedom)
    whole = np.linalg.pinv(covariances, hermitian=True)
    apart = offsets - np.linalg.pinv(whole.sum(axis=0), hermitian=True) @ np.einsum("nij,nj->i", whole, offsets)
    return np.maximum(of_axes, _birge(np.einsum("ni,nij,nj", apart, whole, apart), 6 * freedom))


def _birge(chi_squared: FloatArray, freedom: int) -> FloatArray:
    by_chance = chdtrc(freedom, chi_squared) >= LEAST_PROBABILITY
    return np.where(by_chance, 1.0, np.sqrt(chi_squared / freedom))


def _offsets(estimates: Sequence[Estimate]) -> FloatArray:
    return np.array([estimate.pose.offset_from(estimates[0].pose) for estimate in estimates])
