# SPDX-License-Identifier: Apache-2.0
"""Poses that only objects hold which could have moved between the scans."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica import events
from multilica.acceptance.placement import are_contradicted, held_by_movable
from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.registration.fixed_pair import PartlyFixedCloud, without_movable
from multilica.registration.gicp import GicpCloud
from multilica.registration.movable import MovableSpace, find_movable
from multilica.registration.sensor_biases import prior_sigmas
from multilica.results import PairRegistration, connected
from multilica.results.hypotheses import REPEATED
from multilica.stages.ground import find_levels, rotations_of
from multilica.stages.preprocess import MOVING_SHARE
from multilica.stages.refine import RefinedRig, refine
from multilica.workers import Shared

_NONE_M = np.empty((0, 3))
# Margins of log-odds that cars at another place cost a pose.
_SURE_LEAD = 2.0


@dataclass(frozen=True, slots=True)
class _FixedRequest:
    """A pair to register to fixed objects, with the names under which those of its LiDARs are shared."""

    pair: PairRegistration
    target: str
    source: str


def doubt_movable(state: CalibrationState, rig: RefinedRig, used: Sequence[PairRegistration]) -> RefinedRig:
    """Return the rig with covariances that count fixed objects only, and find the LiDARs that only movable ones hold.

    With one frame, a moving car looks like a parked one. With several, moving points are left out beforehand, but a
    car that crept stays in part: objects beside which points moved are left out whole. If some did move, or if fixed
    objects contradict a pose, all poses are those of the fixed ones.

    Args:
        used: the pairs with which the poses were refined.
    """
    single = {lidar.name for lidar in state.snapshot.lidars if len(lidar.scans) == 1} & {*state.lidars}
    moving_m = _moving_points(state, rig.poses)
    if not len(moving_m) and not any(pair.lidars <= single for pair in used):
        return rig
    cells = _movable_cells(state, rig.poses, moving_m)
    cells_of = {name: cells if name in single else cells.of_moved for name in rig.poses}
    _show_movable(state, cells_of, rig.poses, single)
    chosen = {id(pair): cells if pair.lidars <= single else cells.of_moved for pair in used}
    fixed = _without_movable(state, rig, used, chosen)
    if not fixed:
        return rig
    of_fixed = refine(state.target, rig.poses, [fixed.get(id(pair), pair) for pair in used], state.config.refine)
    offsets = {name: of_fixed.poses[name].offset_from(rig.poses[name]) for name in rig.covariances}
    moved = cells.has_moved or are_contradicted(offsets, of_fixed.covariances)
    after = of_fixed if moved else rig
    covariances = {}
    for name, off in offsets.items():
        covariances[name] = of_fixed.covariances[name] + (0.0 if moved else np.outer(off, off))
        if held := held_by_movable(rig.covariances[name], covariances[name], state.config.acceptance, moved=moved):
            if moved:  # the fit may have stopped between where these and the fixed objects put it
                covariances[name] = covariances[name] + np.outer(off, off)
            elif (elsewhere := _repetition_of(name, used, rig.poses, state.config)) is not None:
                covariances[name] = covariances[name] + np.outer(elsewhere, elsewhere)
                text = f"{held.text}; and the scene repeats {np.linalg.norm(elsewhere[3:]):.1f} m away"
                held = replace(held, text=text)
            state.held = {**state.held, name: held}
    state.fixed_pairs = {
        (pair.target, pair.source): pair for pair in fixed.values() if moved or pair.lidars & {*state.held}
    }
    return replace(after, covariances=covariances)


def _repetition_of(
    name: str, used: Sequence[PairRegistration], poses: Mapping[str, RigidTransform], config: CalibrationConfig
) -> FloatArray | None:
    """Return the offset (6,) to the place where the scene of a LiDAR repeats, if objects that moved may hide that.

    Cars that stood elsewhere when the other LiDAR measured speak against the true pose, and leave one a period away
    with the most evidence. More than one pair of the LiDAR tells them apart.
    """
    own = [pair for pair in used if name in pair.lidars]
    if len(own) != 1 or len(own[0].registrations) < 2:
        return None
    pair, (best, *others) = own[0], own[0].registrations
    other = min(others, key=best.rough_lead_over)
    if not any(each.derivation.startswith(REPEATED) for each in (best, other)):
        return None
    if best.rough_lead_over(other) > _SURE_LEAD * config.acceptance.min_log_odds_margin:
        return None
    there = other.T_target_source.with_target(pair.target)
    pose = poses[pair.target] @ there if name == pair.source else poses[pair.source] @ there.inverse()
    return pose.offset_from(poses[name])


def _moving_points(state: CalibrationState, poses: Mapping[str, RigidTransform]) -> FloatArray:
    """Return the points (K, 3) that moved between frames, of LiDARs with a pose, in the target's frame.

    There are none where nothing but edges seems to move.
    """
    found = [_NONE_M]
    for lidar in state.snapshot.lidars:
        if lidar.name not in poses:
            continue
        moving_m = state.clouds[lidar.name].dropped_m.get("moving", _NONE_M)
        if len(moving_m) > MOVING_SHARE * sum(len(scan.points_m) for scan in lidar.scans):
            found.append(poses[lidar.name].apply(moving_m))
    return np.concatenate(found)


def _without_movable(
    state: CalibrationState,
    rig: RefinedRig,
    used: Sequence[PairRegistration],
    cells: Mapping[int, MovableSpace],
) -> dict[int, PairRegistration]:
    """Return the pairs that movable objects hold as fixed ones do; all by the `id` of the pair."""
    chosen = {id(pair): pair for pair in used if pair.information is not None and not cells[id(pair)].is_empty}
    of_lidars = [key for key in map(id, state.registrations.values()) if key in chosen]
    requests = [_request(chosen[key], cells[key]) for key in of_lidars]
    shared = {
        name: (lidar, cells[key])
        for key, each in zip(of_lidars, requests, strict=True)
        for name, lidar in ((each.target, chosen[key].target), (each.source, chosen[key].source))
    }
    for name, (lidar, movable) in shared.items():
        cloud = state.lidars[lidar].side.cloud
        state.workers.share(name, _partly_fixed(cloud, rig.poses[lidar], movable, state.config))
    found = dict(zip(of_lidars, state.workers.map(_reduce_pair, requests), strict=True))
    state.workers.forget(shared)
    for number, pair in enumerate(used):
        if id(pair) in chosen and id(pair) not in found:
            before = used[:number] if pair.bias_information is None else ()
            clouds = [
                _partly_fixed(_merged_cloud(state, name, before), rig.poses[name], cells[id(pair)], state.config)
                for name in (pair.target, pair.source)
            ]
            found[id(pair)] = _reduced(pair, (clouds[0], clouds[1]), state.config)
    return {
        key: replace(
            pair,
            T_target_source=each.T_target_source,
            information=each.information,
            bias_information=each.bias_information,
        )
        for key, pair in chosen.items()
        if (each := found[key]) is not None
    }


def _show_movable(
    state: CalibrationState,
    cells: Mapping[str, MovableSpace],
    poses: Mapping[str, RigidTransform],
    single: Collection[str],
) -> None:
    if state.observe is events.ignore:
        return
    for name, of_lidar in sorted(cells.items()):
        if not of_lidar.is_empty:
            points_m = state.lidars[name].side.cloud.points_m
            movable_m = points_m[of_lidar.contain(poses[name].apply(points_m))]
            state.observe(events.MovableFound(name, movable_m, len(points_m), moved=name not in single))


def _request(pair: PairRegistration, cells: MovableSpace) -> _FixedRequest:
    without = "moved" if cells.only_moved else "movable"
    return _FixedRequest(_slim(pair), *(f"{name}\0without {without}" for name in (pair.target, pair.source)))


def _partly_fixed(
    cloud: GicpCloud, pose: RigidTransform, cells: MovableSpace, config: CalibrationConfig
) -> PartlyFixedCloud:
    return PartlyFixedCloud(cloud, ~cells.contain(pose.apply(cloud.points_m)), config.fine)


def _reduce_pair(shared: Shared, request: _FixedRequest) -> PairRegistration | None:
    """Register a pair to fixed objects, a task for a worker."""
    return _reduced(request.pair, (shared[request.target], shared[request.source]), shared[request.pair.target].config)


def _reduced(
    pair: PairRegistration, clouds: tuple[PartlyFixedCloud, PartlyFixedCloud], config: CalibrationConfig
) -> PairRegistration | None:
    sigmas = [prior_sigmas(name, config.refine) for name in (pair.target, pair.source)]
    return without_movable(pair, clouds, np.concatenate(sigmas))


def _merged_cloud(state: CalibrationState, root: str, pairs: Sequence[PairRegistration]) -> GicpCloud:
    """Return the cloud of the largest group with that root which the pairs connect."""
    members = connected(root, pairs)
    sides = [side for group, side in sorted(state.sides.items()) if side.cloud.name == root and members >= {*group}]
    return max((side.cloud for side in sides), key=_size, default=state.lidars[root].side.cloud)


def _size(cloud: GicpCloud) -> int:
    return len(cloud.points_m)


def _slim(pair: PairRegistration) -> PairRegistration:
    return replace(pair, registrations=(), steps=())


def _movable_cells(state: CalibrationState, poses: Mapping[str, RigidTransform], moving_m: FloatArray) -> MovableSpace:
    clouds = {name: state.clouds[name].points_m for name in poses}
    levels = find_levels(state.target, clouds, poses, state.config)
    state.level = next(iter(levels), None)
    thinned = ((pose, state.lidars[name].side.cloud) for name, pose in sorted(poses.items()))
    points_m = np.concatenate([pose.apply(cloud.points_m) for pose, cloud in thinned])
    lidars_m = np.array([pose.xyz_m for _, pose in sorted(poses.items())])
    return find_movable(points_m, lidars_m, rotations_of(levels), moving_m)
