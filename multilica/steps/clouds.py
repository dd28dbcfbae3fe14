# SPDX-License-Identifier: Apache-2.0
"""Stages that work on single LiDARs."""

from dataclasses import replace

from multilica import events
from multilica.errors import UnfitSnapshotError
from multilica.snapshot import Snapshot
from multilica.stages.features import compute_features
from multilica.stages.preprocess import preprocess
from multilica.stages.sensor_health import examine_sensor
from multilica.stages.stillness import detect_motion, explain_motion
from multilica.steps.state import CalibrationState

__all__ = ["compute_all_features", "preprocess_clouds", "require_two_lidars"]


def require_two_lidars(snapshot: Snapshot) -> None:
    """Refuse a snapshot without two LiDARs that have returns.

    Raises:
        UnfitSnapshotError: there are fewer.
    """
    with_returns = [lidar.name for lidar in snapshot.lidars if lidar.points_count > 0]
    if len(with_returns) < 2:
        found = ", ".join(with_returns) or "none"
        raise UnfitSnapshotError(
            f"{snapshot.source or 'The snapshot'} has {len(with_returns)} LiDAR(s) with returns ({found}); "
            "calibration needs at least two."
        )


def preprocess_clouds(state: CalibrationState) -> None:
    """Check that the vehicle stands still, check each sensor, and clean its cloud."""
    config, snapshot = state.config, state.snapshot
    if config.stillness.enabled:
        motions = {lidar.name: detect_motion(lidar.scans, config.stillness) for lidar in snapshot.lidars}
        if refusal := explain_motion(motions, snapshot.source):
            raise UnfitSnapshotError(refusal, code="moving_vehicle")
    for lidar in snapshot.lidars:
        health = examine_sensor(lidar, config.preprocess.min_range_m, config.health)
        cloud = replace(preprocess(lidar, config.preprocess, config.stillness), health=health)
        state.health.append(health)
        if len(cloud.points_m):
            state.clouds[lidar.name] = cloud
        state.observe(events.CloudPreprocessed(cloud))
    _require_clouds(state)


def _require_clouds(state: CalibrationState) -> None:
    limits, target = state.config.preprocess, state.config.target
    where = f"{state.snapshot.source or 'The snapshot'} has"
    span = f"between {limits.min_range_m:g} m and {limits.max_range_m:g} m (preprocess.min_range_m, max_range_m)"
    if len(state.clouds) < 2:
        found = ", ".join(state.clouds) or "none"
        raise UnfitSnapshotError(
            f"{where} {len(state.clouds)} LiDAR(s) with returns {span} ({found}); calibration needs at least two."
        )
    if target and target not in state.clouds:
        raise UnfitSnapshotError(
            f"{where} no returns of the target LiDAR '{target}' {span}; "
            f"choose another target: {', '.join(state.clouds)}.",
            code="blind_target",
        )


def compute_all_features(state: CalibrationState) -> None:
    """Compute descriptors of each LiDAR."""
    for name, cloud in state.clouds.items():
        state.features[name] = compute_features(cloud, state.config.features)
        state.observe(events.FeaturesComputed(state.features[name]))
