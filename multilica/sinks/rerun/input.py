# SPDX-License-Identifier: Apache-2.0
"""Clouds of single LiDARs in a recording."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from multilica import events
from multilica.config import CalibrationConfig
from multilica.geometry import Float32Array, RigidTransform
from multilica.sinks.drawing.palette import MUTED, UNDECIDED, VIOLATE, Rgb, heat_colours
from multilica.sinks.drawing.shapes import sample_indices, shown_field_of_view, slot_offsets_m
from multilica.sinks.files.result_files import config_toml
from multilica.sinks.rerun.entity_paths import (
    CONFIG,
    DISPLAY_FRAME,
    DROPPED_TABLE,
    FRAMES,
    ROOT_FRAME,
    lidar_frame,
    lidar_path,
    slot_frame,
)
from multilica.sinks.rerun.scene import CLOCK_TIMELINE, ITERATION_TIMELINE, STEP_TIMELINE, RerunScene, rigid
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine
from multilica.sinks.text.markdown import markdown_table

_DROP_COLOURS: dict[str, Rgb] = {"too_near": VIOLATE, "too_far": MUTED, "moving": UNDECIDED}
_AXIS_LENGTH_M = 1.0
_NORMAL_LENGTH_M = 0.4
_NAME_HEIGHTS = 4
RESIDUAL_SCALE_M = 0.05
"""Residual with the brightest colour: a few times the range noise of vehicle LiDARs."""
# The darkest colours of the scale can hardly be seen on the background.
_DARKEST = 0.15


def log_input(scene: RerunScene, event: events.CalibrationStarted) -> None:
    """Log the raw clouds side by side, and the configuration."""
    scene.log_document(CONFIG, f"```toml\n{config_toml(event.config)}```")
    # Until an entity is logged, the viewer has it in a frame of its own below this one, and reports an error in each
    # view that finds no path from there.
    scene.stream.log(FRAMES, rigid(ROOT_FRAME, DISPLAY_FRAME), static=True)
    offsets_m = slot_offsets_m(event.snapshot)
    for lidar in event.snapshot.lidars:
        frame, offset_m = slot_frame(lidar.name), (0.0, offsets_m[lidar.name], 0.0)
        place = RigidTransform.from_xyz_rpy(DISPLAY_FRAME, frame, offset_m, (0.0, 0.0, 0.0))
        scene.stream.log(lidar_path(lidar.name, "slot"), rigid(frame, DISPLAY_FRAME, place), static=True)
        _log_sensor(scene, lidar.name, event.snapshot.names.index(lidar.name))
        points_m, limit = lidar.points_m, scene.limits.raw_points
        if len(points_m) > limit:
            scene.log_line(LogLine("INFO", f"{lidar.name}: {limit:,} of {len(points_m):,} raw points are recorded"))
        path, frame = lidar_path(lidar.name, "raw"), lidar_frame(lidar.name)
        scene.log_points(path, frame, points_m, scene.colour(lidar.name), limit)


def name_pole_m(index: int, *, top: bool = False, spacing_m: float = 1.2) -> Float32Array:
    """Return the line (1, 2, 3) from a LiDAR to its name, in its own frame.

    Names of neighbours differ in height, to be apart even if the sensors sit close together.

    Args:
        index: of the LiDAR.
        top: above all others.
    """
    level = _NAME_HEIGHTS if top else index % _NAME_HEIGHTS
    return np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, spacing_m * (1 + level)]]], dtype=np.float32)


def _log_sensor(scene: RerunScene, lidar: str, index: int) -> None:
    start = [
        rr.TimeColumn(STEP_TIMELINE, sequence=[0]),
        rr.TimeColumn(ITERATION_TIMELINE, sequence=[0]),
        rr.TimeColumn(CLOCK_TIMELINE, timestamp=[np.datetime64(scene.started_ns, "ns")]),
    ]
    log_in_slot(scene, lidar, start)
    axes = rr.TransformAxes3D(_AXIS_LENGTH_M)
    scene.stream.log(lidar_path(lidar, "sensor"), rr.CoordinateFrame(lidar_frame(lidar)), axes, static=True)
    pole_m = name_pole_m(index)
    name = rr.LineStrips3D(pole_m, colors=[scene.colour(lidar)], radii=rr.Radius.ui_points(1.0))
    tip = rr.Points3D(pole_m[0, 1:], colors=[scene.colour(lidar)], labels=[lidar], radii=rr.Radius.ui_points(3.0))
    scene.log_in(lidar_frame(lidar), lidar_path(lidar, "name"), name)
    scene.log_in(lidar_frame(lidar), lidar_path(lidar, "name", "tip"), tip)


def log_in_slot(scene: RerunScene, lidar: str, times: Sequence[rr.TimeColumn]) -> None:
    """Log the LiDAR's frame in its slot at one time, earlier than any other place of it."""
    pose = RigidTransform.identity(slot_frame(lidar), lidar_frame(lidar))
    columns = rr.Transform3D.columns(
        translation=[pose.xyz_m],
        quaternion=[rr.Quaternion(xyzw=pose.quaternion_xyzw)],
        child_frame=[lidar_frame(lidar)],
        parent_frame=[slot_frame(lidar)],
    )
    scene.stream.send_columns(lidar_path(lidar, "sensor"), times, columns)


def log_preprocessed(scene: RerunScene, event: events.CloudPreprocessed) -> None:
    """Log a LiDAR's preprocessed cloud, its dropped points by reason, and its field of view."""
    cloud, limit = event.cloud, scene.limits.cloud_points
    frame = lidar_frame(cloud.lidar)
    scene.log_points(lidar_path(cloud.lidar, "preprocessed"), frame, cloud.points_m, scene.colour(cloud.lidar), limit)
    strips = shown_field_of_view(scene.state, cloud.lidar)
    if strips:
        lines = rr.LineStrips3D(strips, colors=[scene.colour(cloud.lidar)], radii=rr.Radius.ui_points(0.6))
        scene.log_in(frame, lidar_path(cloud.lidar, "field_of_view"), lines)
    for reason, dropped_m in sorted(cloud.dropped_m.items()):
        finite_m = dropped_m[np.all(np.isfinite(dropped_m), axis=1)]
        path = lidar_path(cloud.lidar, "dropped", reason)
        scene.log_points(path, frame, finite_m, _DROP_COLOURS.get(reason, MUTED), limit)


def log_features(scene: RerunScene, event: events.FeaturesComputed) -> None:
    """Log the points with descriptors, and some normals."""
    features = event.features
    frame = lidar_frame(features.lidar)
    path = lidar_path(features.lidar, "features")
    limit = scene.limits.feature_points
    scene.log_points(path, frame, features.points_m, scene.colour(features.lidar), limit, radius_pixels=2.0)
    if scene.limits.normals:
        shown = sample_indices(len(features.points_m), scene.limits.normals)
        normals = rr.Arrows3D(
            origins=features.points_m[shown].astype(np.float32),
            vectors=(_NORMAL_LENGTH_M * features.normals[shown]).astype(np.float32),
            colors=[MUTED],
            radii=rr.Radius.ui_points(0.5),
        )
        scene.log_in(frame, lidar_path(features.lidar, "features", "normals"), normals)


def log_dropped_table(scene: RerunScene) -> None:
    """Log a table of returns, dropped points by reason and kept points of every LiDAR."""
    state = scene.state
    reasons = sorted({reason for cloud in state.clouds.values() for reason in cloud.dropped_m})
    header = ("LiDAR", "returns", *reasons, "kept", "after thinning")
    table = markdown_table(header, [_dropped_row(state, lidar, reasons) for lidar in state.lidars])
    meanings = "\n".join(f"- `{reason}`: {_meaning(reason, state.config)}" for reason in reasons)
    scene.log_document(DROPPED_TABLE, f"# Dropped points\n\n{table}\n\n{meanings}")


def _dropped_row(state: RunState, lidar: str, reasons: Sequence[str]) -> Sequence[str]:
    total = next(each.points_count for each in state.snapshot.lidars if each.name == lidar) if state.snapshot else 0
    if lidar not in state.clouds:
        return (lidar, f"{total:,}", *("-" for _ in reasons), "-", "-")
    cloud = state.clouds[lidar]
    dropped = (len(cloud.dropped_m.get(reason, ())) for reason in reasons)
    return (
        lidar,
        f"{total:,}",
        *(f"{count:,}" for count in dropped),
        f"{cloud.returns:,}",
        f"{len(cloud.points_m):,}" if cloud.returns else "**none**",
    )


def _meaning(reason: str, config: CalibrationConfig | None) -> str:
    """Describe a reason with the parameter that decides."""
    if config is None:
        return ""
    limits = config.preprocess
    return {
        "too_near": f"nearer than {limits.min_range_m:g} m, such as the vehicle's own body (`preprocess.min_range_m`)",
        "too_far": f"farther than {limits.max_range_m:g} m (`preprocess.max_range_m`)",
        "moving": "moved between frames: beams of other frames pass through its place (`stillness.moving_clearance_m`)",
    }.get(reason, "")


def log_residuals(scene: RerunScene, event: events.ResidualsMeasured) -> None:
    """Log the points of a LiDAR that others saw as well, coloured by their distance to the others' surfaces."""
    found = event.residuals
    rows = sample_indices(len(found.points_m), scene.limits.cloud_points)
    colours = heat_colours(_DARKEST + (1.0 - _DARKEST) * found.residual_m[rows] / RESIDUAL_SCALE_M)
    shown = rr.Points3D(found.points_m[rows].astype(np.float32), colors=colours, radii=rr.Radius.ui_points(2.0))
    scene.log_in(lidar_frame(found.lidar), lidar_path(found.lidar, "residual"), shown)
