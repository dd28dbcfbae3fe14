# SPDX-License-Identifier: Apache-2.0
"""Poses that only objects hold which could have moved between the scans."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.acceptance.placement import held_by_movable
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.registration.fixed_pair import without_movable
from multilica.registration.movable import MovableCells, find_movable
from multilica.registration.sensor_biases import prior_sigmas
from multilica.results import PairRegistration
from multilica.stages.ground import estimate_level
from multilica.stages.refine import RefinedRig, refine
from multilica.workers import Shared


@dataclass(frozen=True, slots=True, eq=False)
class _FixedRequest:
    """A pair with the movable cells, and the poses of its LiDARs in their frame."""

    pair: PairRegistration
    cells: MovableCells
    poses: tuple[RigidTransform, RigidTransform]


def doubt_movable(
    state: CalibrationState, rig: RefinedRig, used: Sequence[PairRegistration]
) -> Mapping[str, FloatArray]:
    """Find the LiDARs whose poses only movable objects hold, and return the covariances with those of fixed ones.

    With several frames, moving points are left out beforehand. With one, a moving car looks like a parked one.

    Args:
        used: the pairs with which the poses were refined.
    """
    single = {lidar.name for lidar in state.snapshot.lidars if len(lidar.scans) == 1} & {*state.lidars}
    # Merges of groups are left out: their clouds are others.
    of_lidars = {id(pair) for pair in state.registrations.values()}
    chosen = [pair for pair in used if pair.information is not None and pair.lidars <= single and id(pair) in of_lidars]
    if not chosen:
        return rig.covariances
    cells = _movable_cells(state, rig.poses)
    if not len(cells.keys):
        return rig.covariances
    requests = [_FixedRequest(_slim(pair), cells, (rig.poses[pair.target], rig.poses[pair.source])) for pair in chosen]
    found = zip(chosen, state.workers.map(compare_fixed, requests), strict=True)
    fixed = {
        (pair.target, pair.source): replace(pair, information=each.information, bias_information=each.bias_information)
        for pair, each in found
        if each is not None
    }
    if not fixed:
        return rig.covariances
    of_fixed = refine(
        state.target,
        rig.poses,
        [fixed.get((pair.target, pair.source), pair) for pair in used],
        state.config.refine,
    )
    covariances = dict(rig.covariances)
    for name, covariance in rig.covariances.items():
        off = of_fixed.poses[name].offset_from(rig.poses[name])
        without = of_fixed.covariances[name] + np.outer(off, off)
        if held := held_by_movable(covariance, without, state.config.acceptance):
            state.held = {**state.held, name: held}
            covariances[name] = without
    state.fixed_pairs = {key: pair for key, pair in fixed.items() if pair.lidars & {*state.held}}
    return covariances


def compare_fixed(lidars: Shared, request: _FixedRequest) -> PairRegistration | None:
    """Compute the information of fixed objects, a task for a worker."""
    pair, cells = request.pair, request.cells
    sides = [lidars[name] for name in (pair.target, pair.source)]
    clouds = sides[0].side.cloud, sides[1].side.cloud
    of_target, of_source = (
        cells.contain(pose.apply(cloud.points_m)) for cloud, pose in zip(clouds, request.poses, strict=True)
    )
    config = sides[0].config.refine
    sigmas = np.concatenate([prior_sigmas(cloud.name, config) for cloud in clouds])
    return without_movable(pair, clouds, (of_target, of_source), sigmas)


def _slim(pair: PairRegistration) -> PairRegistration:
    return replace(pair, registrations=(), steps=())


def _movable_cells(state: CalibrationState, poses: Mapping[str, RigidTransform]) -> MovableCells:
    clouds = {name: state.clouds[name].points_m for name in poses}
    state.level = level = estimate_level(state.target, clouds, poses, state.config)
    points_m = np.concatenate([poses[name].apply(cloud_m) for name, cloud_m in sorted(clouds.items())])
    lidars_m = np.array([pose.xyz_m for _, pose in sorted(poses.items())])
    return find_movable(points_m, lidars_m, np.eye(3) if level is None else level.rotation)
