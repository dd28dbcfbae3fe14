# SPDX-License-Identifier: Apache-2.0
"""What the LiDARs saw, as a recording shows it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import FeatureCloud
from multilica.sinks.narration import LogLine
from multilica.sinks.palette import MUTED, VIOLATE, Rgb
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import CONFIG, DISPLAY_FRAME, lidar_frame, lidar_path, slot_frame
from multilica.sinks.thinning import sample_indices
from multilica.sinks.toml_text import toml_text
from multilica.snapshot import Float32Array, LidarScans, Snapshot

__all__ = ["log_features", "log_input", "log_preprocessed", "shown_radius_m"]

_DROP_COLOURS: dict[str, Rgb] = {"too_near": VIOLATE, "too_far": MUTED}
_AXIS_LENGTH_M = 1.0
_MAX_NORMALS = 1500
_NORMAL_LENGTH_M = 0.4


def log_input(scene: Scene, event: events.CalibrationStarted) -> None:
    """Raw clouds, side by side, and the configuration."""
    table = event.config.model_dump(mode="json")
    scene.log(CONFIG, rr.TextDocument(f"```toml\n{toml_text(table)}```", media_type=rr.MediaType.MARKDOWN))
    offsets_m = _slot_offsets_m(event.snapshot)
    for lidar in event.snapshot.lidars:
        frame, offset_m = slot_frame(lidar.name), (0.0, offsets_m[lidar.name], 0.0)
        place = RigidTransform.from_xyz_rpy(DISPLAY_FRAME, frame, offset_m, (0.0, 0.0, 0.0))
        scene.log(lidar_path(lidar.name, "slot"), rigid(frame, DISPLAY_FRAME, place))
        _log_sensor(scene, lidar.name, event.snapshot.names.index(lidar.name))
        _log_raw(scene, lidar)


def _slot_offsets_m(snapshot: Snapshot) -> dict[str, float]:
    """Along y, so that no cloud's dense part covers another's."""
    offsets_m: dict[str, float] = {}
    edge_m = 0.0
    for lidar in snapshot.lidars:
        radius_m = shown_radius_m(_raw_points(lidar))
        offsets_m[lidar.name] = edge_m - radius_m
        edge_m -= 2.0 * radius_m
    return offsets_m


def shown_radius_m(points_m: npt.NDArray[np.floating]) -> float:
    """Radius around the sensor that holds most of a cloud (N, 3)."""
    finite = points_m[np.all(np.isfinite(points_m), axis=1)]
    if len(finite) == 0:
        return 5.0
    return float(np.clip(np.percentile(np.linalg.norm(finite[:, :2], axis=1), 75.0), 5.0, 40.0))


def _raw_points(lidar: LidarScans) -> Float32Array:
    scans = [scan.points_m for scan in lidar.scans]
    return np.concatenate(scans) if scans else np.empty((0, 3), dtype=np.float32)


def _log_sensor(scene: Scene, lidar: str, index: int) -> None:
    pose = rigid(lidar_frame(lidar), slot_frame(lidar))
    scene.log(lidar_path(lidar, "sensor"), pose, rr.TransformAxes3D(_AXIS_LENGTH_M))
    # Poles of different heights keep the names apart when the sensors sit close together.
    pole = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.2 + 0.8 * index]]
    name = rr.LineStrips3D([pole], colors=[scene.colour(lidar)], radii=rr.Radius.ui_points(1.0))
    tip = rr.Points3D([pole[1]], colors=[scene.colour(lidar)], labels=[lidar], radii=rr.Radius.ui_points(3.0))
    scene.log(lidar_path(lidar, "name"), rr.CoordinateFrame(lidar_frame(lidar)), name)
    scene.log(lidar_path(lidar, "name", "tip"), rr.CoordinateFrame(lidar_frame(lidar)), tip)


def _log_raw(scene: Scene, lidar: LidarScans) -> None:
    points_m = _raw_points(lidar)
    if len(points_m) > scene.max_cloud_points:
        text = f"{lidar.name}: {scene.max_cloud_points:,} of {len(points_m):,} raw points are in this recording"
        scene.log_line(LogLine("INFO", text))
    scene.log_points(lidar_path(lidar.name, "raw"), lidar_frame(lidar.name), points_m, scene.colour(lidar.name))


def log_preprocessed(scene: Scene, event: events.CloudPreprocessed) -> None:
    """The cleaned cloud of a LiDAR, with what was dropped by reason."""
    cloud = event.cloud
    frame = lidar_frame(cloud.lidar)
    scene.log_points(lidar_path(cloud.lidar, "preprocessed"), frame, cloud.points_m, scene.colour(cloud.lidar))
    for reason, dropped_m in sorted(cloud.dropped_m.items()):
        finite_m = dropped_m[np.all(np.isfinite(dropped_m), axis=1)]
        path = lidar_path(cloud.lidar, "dropped", reason)
        scene.log_points(path, frame, finite_m, _DROP_COLOURS.get(reason, MUTED))


def log_features(scene: Scene, event: events.FeaturesComputed) -> None:
    """Where descriptors were computed, with some of the normals."""
    features = event.features
    frame = lidar_frame(features.lidar)
    path = lidar_path(features.lidar, "features")
    scene.log_points(path, frame, features.points_m, scene.colour(features.lidar), radius_pixels=2.0)
    scene.log(lidar_path(features.lidar, "features", "normals"), rr.CoordinateFrame(frame), _normals(features))


def _normals(features: FeatureCloud) -> rr.Arrows3D:
    shown = sample_indices(len(features.points_m), _MAX_NORMALS)
    return rr.Arrows3D(
        origins=features.points_m[shown].astype(np.float32),
        vectors=(_NORMAL_LENGTH_M * features.normals[shown]).astype(np.float32),
        colors=[MUTED],
        radii=rr.Radius.ui_points(0.5),
    )
