# SPDX-License-Identifier: Apache-2.0
"""Surfaces of the LiDARs compared in their final poses, for those who observe the calibration."""

import sys
from dataclasses import dataclass

from multilica import events
from multilica.geometry import RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.stages.surface_distances import PairMatches, match_surfaces, residuals_of
from multilica.workers import Shared

# Enough to see where a pair does not meet; `--record full` has all.
_ENOUGH_POINTS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class _BothWays:
    """Matches of the source's points in the target, and the other way round."""

    forward: PairMatches
    backward: PairMatches


def compare_surfaces(state: CalibrationState) -> None:
    """Report the matches of each registered pair, and the residual of the merged cloud at each placed LiDAR."""
    if state.observe is events.ignore:
        return
    poses = {key: _final_pose(state, pair.T_target_source) for key, pair in sorted(state.registrations.items())}
    compared = dict(zip(poses, state.workers.map(_compare, list(poses.values())), strict=True))
    of_lidar: dict[str, list[PairMatches]] = {}
    for key, both in compared.items():
        state.observe(events.SurfacesMatched(both.forward.matches))
        if state.registrations[key].verdict.accepted and {*key} <= {*state.poses}:
            for each in (both.forward, both.backward):
                of_lidar.setdefault(each.matches.source, []).append(each)
    for name, found in sorted(of_lidar.items()):
        state.observe(events.ResidualsMeasured(residuals_of(state.lidars[name].side.cloud, found)))


def _final_pose(state: CalibrationState, registered: RigidTransform) -> RigidTransform:
    """Return the pose in the rig; that of the registration where the rig lacks one of the two."""
    target, source = registered.target, registered.source
    if target in state.poses and source in state.poses:
        return state.poses[target].inverse() @ state.poses[source]
    return registered


def _compare(lidars: Shared, pose: RigidTransform) -> _BothWays:
    target, source = lidars[pose.target], lidars[pose.source]
    clouds, config = (target.side.cloud, source.side.cloud), target.config
    most = sys.maxsize if config.record.detail == "full" else _ENOUGH_POINTS
    limits = config.fine.fitness_distance_m, most
    return _BothWays(match_surfaces(*clouds, pose, *limits), match_surfaces(*clouds[::-1], pose.inverse(), *limits))
