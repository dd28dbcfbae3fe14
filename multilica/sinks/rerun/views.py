# SPDX-License-Identifier: Apache-2.0
"""Views of a blueprint with their cameras."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.encodings import EntityPathLike

from multilica.geometry import FloatArray
from multilica.results import PairKey
from multilica.sinks.drawing import distinct_colours, kept_count, sample_points, shown_radius_m, slot_offsets_m
from multilica.sinks.rerun.pairs import lift_m
from multilica.sinks.rerun.scene import LOG, lidar_frame, lidar_path, pair_path
from multilica.sinks.run_state import Extent, RunState
from multilica.sinks.text.log_lines import pair_label

Overrides = dict[EntityPathLike, rr.Points3D | rr.LineStrips3D]
"""Components by entity, in place of the logged ones."""
_SAMPLE = 20_000
_FAR_SHARE = 75.0
_RADIUS_LIMITS_M = (6.0, 40.0)
_ASIDE_M = 1.0
_DARK = (13, 16, 17)
_DIM = 0.45
_SCORED_LEGEND = ": green agrees, red lies in proven-empty space, grey is occluded"


def around_lidar(state: RunState, lidar: str, *, zoom: float = 1.0, raised_m: float = 0.0) -> rrb.EyeControls3D:
    """Look at one LiDAR's cloud in its own frame, or at a point above it; a smaller zoom shows more around it."""
    extent = _shown_extent(state, lidar)
    centre_m = extent.centre_m + np.array([0.0, 0.0, raised_m])
    return three_quarter(centre_m, extent.radius_m / zoom, up_axis(state, lidar))


def beside_lidar(state: RunState, lidar: str) -> rrb.EyeControls3D:
    """Look at one LiDAR's cloud from the side, for a view that is wider than high."""
    centre_m, radius_m, _ = _shown_extent(state, lidar)
    up = up_axis(state, lidar)
    ahead, aside = _horizontal(up, centre_m)
    position = centre_m + radius_m * (-0.5 * ahead - 1.3 * aside + 1.1 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def around_rig(state: RunState) -> rrb.EyeControls3D:
    """Look at the clouds of all LiDARs with a pose, in the target's frame."""
    document = state.document
    clouds = [pose.apply(sampled_cloud(state, name)) for name, pose in document.poses.items()]
    return three_quarter(*_extent(np.concatenate([np.empty((0, 3)), *clouds])), up_axis(state, document.target))


def three_quarter(centre_m: FloatArray, radius_m: float, up: FloatArray) -> rrb.EyeControls3D:
    """Look from behind, the side and above, so that the radius fills the view."""
    ahead, aside = _horizontal(up)
    position = centre_m + radius_m * (-1.05 * ahead - 0.55 * aside + 0.95 * up)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def above_group(state: RunState) -> rrb.EyeControls3D:
    """Look down on the slot in which the target's group grows, slightly tilted."""
    centre_m = np.array([0.0, slot_offsets_m(state).get(state.target, 0.0), 0.0])
    radius_m = _shown_extent(state, state.target).reach_m
    up = up_axis(state, state.target)
    ahead, _ = _horizontal(up)
    position = centre_m + 2.0 * radius_m * (0.9 * up - 0.7 * ahead)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def above_drive(state: RunState, first: str) -> rrb.EyeControls3D:
    """Look down on the stops that links connect with the first one, in the target's frame there, slightly tilted."""
    document = state.document
    places_m = np.array([np.asarray(stop.T_first_stop)[:3, 3] for stop in document.stops if stop.first == first])
    centre_m = np.mean(places_m, axis=0)
    seen_m = max((_shown_extent(state, lidar).reach_m for lidar in document.poses), default=0.0)
    radius_m = float(np.linalg.norm(places_m - centre_m, axis=1).max()) + seen_m
    up = up_axis(state, document.target)
    ahead, _ = _horizontal(up)
    position = centre_m + radius_m * (1.8 * up - 0.4 * ahead)
    return rrb.EyeControls3D(position=position, look_target=centre_m, eye_up=up)


def sampled_cloud(state: RunState, lidar: str) -> FloatArray:
    """Return a sample (N, 3) of a LiDAR's preprocessed points; none before it is preprocessed."""
    if lidar not in state.clouds:
        return np.empty((0, 3))
    return sample_points(state.clouds[lidar].points_m, _SAMPLE).astype(np.float64)


def up_axis(state: RunState, lidar: str) -> FloatArray:
    """Return the up axis (3,) in the LiDAR's frame: its z axis until its pose, and the ground or a level, are known."""
    document, up = state.document, np.array([0.0, 0.0, 1.0])
    pose = document.poses.get(lidar)
    if pose is None:
        return up
    if document.ground is not None:
        up = np.asarray(document.ground.normal)
    elif state.result is not None and state.result.level is not None:
        up = state.result.level.rotation[2]
    return np.asarray(pose.rotation.T @ up)


def _shown_extent(state: RunState, lidar: str) -> Extent:
    """Return the cached extent of a LiDAR's preprocessed cloud."""
    if lidar not in state.clouds:
        return _whole_extent(np.empty((0, 3)))
    if lidar not in state.extents:
        state.extents[lidar] = _whole_extent(sampled_cloud(state, lidar))
    return state.extents[lidar]


def _whole_extent(points_m: FloatArray) -> Extent:
    return Extent(*_extent(points_m), shown_radius_m(points_m))


def _extent(points_m: FloatArray) -> tuple[FloatArray, float]:
    """Return centre and radius of the dense part of a cloud (N, 3).

    The centre of a LiDAR that looks one way lies between its cloud and the sensor.
    """
    if len(points_m) == 0:
        return np.zeros(3), _RADIUS_LIMITS_M[0]
    centre_m = 0.6 * np.median(points_m, axis=0)
    radius_m = np.percentile(np.linalg.norm(points_m - centre_m, axis=1), _FAR_SHARE)
    return centre_m, float(np.clip(radius_m, *_RADIUS_LIMITS_M))


def _horizontal(up: FloatArray, towards_m: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the level directions ahead and left.

    Args:
        towards_m: (3,) point ahead; x, or y where x is nearly up, if it is not given or close to the sensor.
    """
    axis = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    if towards_m is not None and np.linalg.norm(np.cross(up, towards_m)) > _ASIDE_M:
        axis = towards_m
    ahead = axis - (axis @ up) * up
    ahead /= np.linalg.norm(ahead)
    return ahead, np.cross(up, ahead)


def scene_view(
    name: str,
    frame: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D,
    *,
    grid: bool = False,
    overrides: Overrides | None = None,
) -> rrb.Spatial3DView:
    """Show entities in a frame."""
    return rrb.Spatial3DView(
        origin="/",
        contents=list(contents),
        name=name,
        spatial_information=rrb.SpatialInformation(target_frame=frame),
        eye_controls=eye,
        line_grid=grid,
        overrides=overrides,
        background=_DARK,
    )


def single_lidar_view(state: RunState, lidar: str, parts: Sequence[str], name: str = "") -> rrb.Spatial3DView:
    """Show entities of one LiDAR in its own frame."""
    contents = [f"{lidar_path(lidar, part)}/**" for part in ("sensor", *parts)]
    return scene_view(name or lidar, lidar_frame(lidar), contents, around_lidar(state, lidar))


def matches_view(state: RunState, pair: PairKey, *, kept_only: bool = False) -> rrb.Spatial3DView:
    """Show the matches of a pair, or only those kept, from far enough to see both layers."""
    contents = [lidar_path(pair[0], "features"), f"{pair_path(*pair, 'matches')}/**"]
    hidden = [f"- {pair_path(*pair, 'matches', 'rejected')}"] if kept_only else []
    name = _matches_legend(state, pair, kept_only=kept_only)
    raised_m = lift_m(state.matches[pair]) / 2.0 if state.matches.get(pair) else 0.0
    eye = around_lidar(state, pair[0], zoom=0.6, raised_m=raised_m)
    return pair_view(pair, name, [*contents, *hidden], eye)


def _matches_legend(state: RunState, pair: PairKey, *, kept_only: bool) -> str:
    """Count the matches that the best hypothesis keeps and rejects, with their colours."""
    total, kept = len(state.matches.get(pair, ())), kept_count(state, pair)
    if pair not in state.coarse:
        return f"{pair_label(*pair)}: {total:,} matches (grey)"
    if kept_only:
        return f"{pair_label(*pair)}: {kept:,} of {total:,} matches kept (green)"
    return f"{pair_label(*pair)}: {kept:,} kept (green), {total - kept:,} rejected (red)"


def scored_view(state: RunState, pair: PairKey, *, wide: bool = False) -> rrb.Spatial3DView:
    """Show a pair at the pose of the step, its clouds dimmed below the scored points."""
    clouds = {lidar_path(pair[0], "preprocessed"): pair[0], pair_path(*pair, "source"): pair[1]}
    contents = [*clouds, f"{pair_path(*pair, 'scored')}/**", pair_path(*pair, "verdict"), pair_path(*pair, "slide")]
    colours, found = distinct_colours(state.lidars), state.registrations.get(pair)
    overrides: Overrides = {}
    for path, lidar in clouds.items():
        dimmed = [int(_DIM * channel) for channel in colours[lidar]]
        overrides[path] = rr.Points3D.from_fields(colors=[dimmed], radii=rr.Radius.ui_points(1.0))
    is_scored = state.verified.get(pair) or (found is not None and found.registrations)
    name = f"{pair_label(*pair)}{_SCORED_LEGEND if is_scored else ''}"
    eye = (beside_lidar if wide else around_lidar)(state, pair[0])
    return pair_view(pair, name, contents, eye, overrides=overrides)


def pair_view(
    pair: PairKey, name: str, contents: Sequence[str], eye: rrb.EyeControls3D, overrides: Overrides | None = None
) -> rrb.Spatial3DView:
    """Show entities of a pair in the target's frame."""
    sensor = lidar_path(pair[0], "sensor")
    return scene_view(name, lidar_frame(pair[0]), [sensor, *contents], eye, overrides=overrides)


def log_view(name: str = "Log", levels: Sequence[str] = ("INFO", "WARN", "ERROR")) -> rrb.TextLogView:
    """Show the log lines of some levels."""
    return rrb.TextLogView(
        origin=LOG,
        name=name,
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["LogLevel", "Body"]),
        rows=rrb.TextLogRows(filter_by_log_level=list(levels)),
    )


def document_view(path: str, name: str) -> rrb.TextDocumentView:
    """Show a markdown document."""
    return rrb.TextDocumentView(origin=path, contents=[path], name=name)
