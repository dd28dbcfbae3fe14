# SPDX-License-Identifier: Apache-2.0
"""Stages that work on single LiDARs."""

from dataclasses import dataclass, replace

from multilica import events
from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.orchestration.pairs import PreparedLidar, prepare_lidar
from multilica.orchestration.state import CalibrationState
from multilica.results import PreprocessedCloud, SensorHealth
from multilica.snapshot import LidarScans, Snapshot
from multilica.stages.preprocess import preprocess
from multilica.stages.sensor_health import examine_sensor
from multilica.stages.stillness import Motion, detect_motion, explain_motion
from multilica.workers import Shared


def require_two_lidars(snapshot: Snapshot) -> None:
    """Refuse a snapshot without two LiDARs that have returns.

    Raises:
        UnfitSnapshotError: there are fewer.
    """
    with_returns = [lidar.name for lidar in snapshot.lidars if lidar.points_count > 0]
    if len(with_returns) < 2:
        found = ", ".join(with_returns) or "none"
        raise UnfitSnapshotError(
            f"{snapshot.source or 'The snapshot'} has {len(with_returns)} LiDAR(s) with returns ({found}). "
            "Calibration needs at least two."
        )


def preprocess_clouds(state: CalibrationState) -> None:
    """Check that the vehicle stands still, check each sensor, and clean its cloud."""
    config, snapshot = state.config, state.snapshot
    tasks = {_cleaned(lidar.name): (lidar, config) for lidar in snapshot.lidars}
    cleaned = [each for _, each in state.workers.map_and_share(clean_lidar, tasks)]
    motions = {each.cloud.lidar: each.motion for each in cleaned}
    if refusal := explain_motion({name: motion for name, motion in motions.items() if motion}, snapshot.source):
        raise UnfitSnapshotError(refusal, code="moving_vehicle")
    for each in cleaned:
        state.health.append(each.health)
        if len(each.cloud.points_m):
            state.clouds[each.cloud.lidar] = each.cloud.slim()
        state.observe(events.CloudPreprocessed(each.cloud))
    _require_clouds(state)


@dataclass(frozen=True, slots=True, eq=False)
class CleanedLidar:
    """A LiDAR's cloud with its health and motion; None where stillness is not checked."""

    cloud: PreprocessedCloud
    health: SensorHealth
    motion: Motion | None


def clean_lidar(shared: object, task: tuple[LidarScans, CalibrationConfig]) -> CleanedLidar:
    """Clean one LiDAR's cloud, a task for a worker."""
    del shared
    lidar, config = task
    motion = detect_motion(lidar.scans, config.stillness) if config.stillness.enabled else None
    health = examine_sensor(lidar, config.preprocess.min_range_m, config.health)
    cloud = replace(preprocess(lidar, config.preprocess, config.stillness), health=health)
    return CleanedLidar(cloud, health, motion)


def _require_clouds(state: CalibrationState) -> None:
    limits, target = state.config.preprocess, state.config.target
    where = f"{state.snapshot.source or 'The snapshot'} has"
    span = f"between {limits.min_range_m:g} m and {limits.max_range_m:g} m (preprocess.min_range_m, max_range_m)"
    if len(state.clouds) < 2:
        found = ", ".join(state.clouds) or "none"
        raise UnfitSnapshotError(
            f"{where} {len(state.clouds)} LiDAR(s) with returns {span} ({found}). Calibration needs at least two."
        )
    if target and target not in state.clouds:
        raise UnfitSnapshotError(
            f"{where} no returns of the target LiDAR '{target}' {span}; "
            f"choose another target: {', '.join(state.clouds)}.",
            code="blind_target",
        )


def prepare_lidars(state: CalibrationState, *, described: bool = True) -> None:
    """Compute descriptors of each LiDAR, and prepare it for the work on pairs.

    Args:
        described: False leaves the descriptors out, where nothing is searched.
    """
    tasks = {name: (name, state.config, described) for name in state.clouds}
    for name, lidar in state.workers.map_and_share(prepare_one, tasks):
        state.lidars[name] = lidar
        state.observe(events.FeaturesComputed(lidar.features))
    state.workers.forget([_cleaned(lidar.name) for lidar in state.snapshot.lidars])


def prepare_one(shared: Shared, task: tuple[str, CalibrationConfig, bool]) -> PreparedLidar:
    """Prepare one LiDAR, a task for a worker."""
    name, config, described = task
    return prepare_lidar(shared[_cleaned(name)].cloud, config, described=described)


def _cleaned(lidar: str) -> str:
    """Return the name under which a cleaned LiDAR is shared, apart from that of the prepared one."""
    return f"{lidar}, cleaned"
