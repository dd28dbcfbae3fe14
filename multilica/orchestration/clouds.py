# SPDX-License-Identifier: Apache-2.0
"""Requirements of a calibration, and stages that work on single LiDARs."""

from dataclasses import dataclass, replace

import numpy as np

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.errors import UnfitSnapshotError
from multilica.geometry import lengths
from multilica.optional_libraries import raise_missing, require_library
from multilica.orchestration.pairs import PreparedLidar, prepare_lidar
from multilica.orchestration.state import CalibrationState
from multilica.results import PreprocessedCloud, SensorHealth
from multilica.snapshot import LidarScans, Snapshot
from multilica.solvers import solver_in_use
from multilica.stages.preprocess import preprocess
from multilica.stages.sensor_health import examine_sensor
from multilica.stages.slow_motion import slow_motion_of
from multilica.stages.stillness import Motion, detect_motion, explain_motion
from multilica.system_libraries import missing_for_open3d
from multilica.workers import Shared

_LIBRARY_OF_SOLVER = {"maximum_clique": "networkx", "kiss_matcher": "kiss_matcher"}


def require_libraries(config: CalibrationConfig) -> None:
    """Check that the libraries of the engines and the solver of the stages to run are there, without importing them.

    Raises:
        MissingDependencyError: a library, or a system library that it loads, is missing.
    """
    solver = solver_in_use(config.coarse)
    wanted: tuple[tuple[Stage, str, str | None], ...] = (
        ("features", "The engine 'open3d' of features", "open3d" if config.features.engine == "open3d" else None),
        ("coarse", f"The solver '{solver}'", _LIBRARY_OF_SOLVER.get(solver)),
        ("fine", "The engine 'open3d' of fine", "open3d" if config.fine.engine == "open3d" else None),
    )
    for stage, name, module in wanted:
        if module and STAGES.index(config.until) >= STAGES.index(stage):
            require_library(name, module)
            if module == "open3d" and missing_for_open3d():
                raise_missing(name, module, ImportError("a shared object file is missing"))


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


def without_blind_target(snapshot: Snapshot, config: CalibrationConfig) -> CalibrationConfig:
    """Leave the target of one stop of several open if the LiDAR that the user asks for is absent or sees nothing."""
    if config.target in snapshot.names:
        nearest_m, farthest_m = config.preprocess.min_range_m, config.preprocess.max_range_m
        ranges_m = (lengths(scan.points_m) for scan in snapshot[config.target].scans)
        if any(np.any((range_m >= nearest_m) & (range_m <= farthest_m)) for range_m in ranges_m):
            return config
    return config.model_copy(update={"target": ""})


def preprocess_clouds(state: CalibrationState) -> None:
    """Check that the vehicle stands still, check each sensor, and clean its cloud."""
    config, snapshot = state.config, state.snapshot
    tasks = {_cleaned(lidar.name): (lidar, config) for lidar in snapshot.lidars}
    cleaned = [each for _, each in state.workers.map_and_share(clean_lidar, tasks)]
    motions = {each.cloud.lidar: each.motion for each in cleaned}
    if refusal := explain_motion({name: motion for name, motion in motions.items() if motion}, snapshot.source):
        raise UnfitSnapshotError(refusal, code="moving_vehicle")
    seen = {name: (motion.shift_m, motion.turn_rad) for name, motion in motions.items() if motion and motion.observable}
    state.slow_motion = slow_motion_of(snapshot.lidars, seen)
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
