# SPDX-License-Identifier: Apache-2.0
"""Calibrated rigs laid over each other, as a Rerun recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray
from multilica.sinks.palette import distinct_colours
from multilica.sinks.rerun_camera import three_quarter
from multilica.sinks.rerun_scene import rigid
from multilica.sinks.rerun_tree import DISPLAY_FRAME, SUMMARY
from multilica.sinks.rerun_views import scene_view, summary_view
from multilica.sinks.thinning import sample_points
from multilica.snapshot import Float32Array

__all__ = ["LaidRig", "write_rigs"]

_APPLICATION_ID = "multilica_diff"
_MAX_CLOUD_POINTS = 200_000
_AXIS_LENGTH_M = 0.5
_SHOWN_SHARE = 75.0
_LEAST_RADIUS_M = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class LaidRig:
    """A rig of one run.

    Args:
        label: its name in the recording.
        extrinsics: poses in the frame that all rigs have in common.
        clouds_m: per LiDAR (N, 3) in its own frame.
    """

    label: str
    extrinsics: Extrinsics
    clouds_m: Mapping[str, Float32Array]


def write_rigs(path: Path, rigs: Sequence[LaidRig], summary: str) -> None:
    """Write a recording in which each rig has a colour of its own.

    Entities are `/rigs/<label>/<lidar>` and `/summary`, frames `<label>/<lidar>` in `<label>/rig` in `display`.

    Args:
        path: ends in `.rrd`; what lies there is replaced when the recording is whole.
        summary: markdown.

    Raises:
        UsageError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.rrd")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise UsageError(f"Cannot write {path}: {error.strerror or error}; give another --recording FILE.") from error
    try:
        _write(temporary, rigs, summary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _write(path: Path, rigs: Sequence[LaidRig], summary: str) -> None:
    stream = rr.RecordingStream(_APPLICATION_ID, send_properties=False)
    stream.set_sinks(rr.FileSink(path), default_blueprint=_blueprint(rigs))
    stream.log(SUMMARY, rr.TextDocument(summary, media_type=rr.MediaType.MARKDOWN), static=True)
    colours = distinct_colours([rig.label for rig in rigs])
    for rig in rigs:
        root = f"{rig.label}/rig"
        stream.log(_path(rig), rigid(root, DISPLAY_FRAME), static=True)
        for lidar, pose in rig.extrinsics.T_target_source.items():
            frame = f"{rig.label}/{lidar}"
            axes = rr.TransformAxes3D(_AXIS_LENGTH_M)
            stream.log(_path(rig, lidar, "sensor"), rigid(frame, root, pose), axes, static=True)
            points = rr.Points3D(
                sample_points(rig.clouds_m.get(lidar, np.empty((0, 3))), _MAX_CLOUD_POINTS),
                colors=[colours[rig.label]],
                radii=rr.Radius.ui_points(1.25),
            )
            stream.log(_path(rig, lidar, "points"), rr.CoordinateFrame(frame), points, static=True)
    stream.flush()
    stream.disconnect()


def _path(rig: LaidRig, *parts: str) -> str:
    return rr.new_entity_path(["rigs", rig.label, *parts])


def _blueprint(rigs: Sequence[LaidRig]) -> rrb.Blueprint:
    both = scene_view("Both rigs", DISPLAY_FRAME, ["/rigs/**"], _eye(rigs))
    single = [scene_view(rig.label, DISPLAY_FRAME, [f"{_path(rig)}/**"], _eye(rigs)) for rig in rigs]
    main = rrb.Tabs(both, *single)
    return rrb.Blueprint(rrb.Horizontal(main, summary_view(), column_shares=[2, 1]), collapse_panels=True)


def _eye(rigs: Sequence[LaidRig]) -> rrb.EyeControls3D:
    points_m = np.concatenate([np.empty((0, 3)), *(_shown(rig) for rig in rigs)])
    if len(points_m) == 0:
        return three_quarter(np.zeros(3), _LEAST_RADIUS_M, np.array([0.0, 0.0, 1.0]))
    centre_m = np.median(points_m, axis=0)
    radius_m = float(np.percentile(np.linalg.norm(points_m - centre_m, axis=1), _SHOWN_SHARE))
    return three_quarter(centre_m, max(radius_m, _LEAST_RADIUS_M), np.array([0.0, 0.0, 1.0]))


def _shown(rig: LaidRig) -> FloatArray:
    placed = rig.extrinsics.T_target_source.items()
    clouds = [pose.apply(rig.clouds_m[lidar]) for lidar, pose in placed if lidar in rig.clouds_m]
    return np.concatenate([np.empty((0, 3)), *clouds])
