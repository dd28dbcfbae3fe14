# SPDX-License-Identifier: Apache-2.0
"""Clouds and places of the LiDARs in a recording."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.geometry import Float32Array, RigidTransform
from multilica.results import GroundPlane, MergeCandidate, MergeDecision, PairKey, PreprocessedCloud
from multilica.results.document import ResultDocument
from multilica.sinks import drawing
from multilica.sinks.drawing import MUTED, UNDECIDED, VERDICT_COLOURS, VIOLATE, Rgb, heat_colours
from multilica.sinks.files.result_files import config_toml
from multilica.sinks.rerun.scene import (
    CLOCK_TIMELINE,
    CONFIG,
    DISPLAY_FRAME,
    DROPPED_TABLE,
    FRAMES,
    GROUND,
    ITERATION_TIMELINE,
    MERGE_GRAPH,
    MERGE_STEPS,
    ROOT_FRAME,
    STEP_TIMELINE,
    STOP_TIMELINE,
    RerunScene,
    lidar_frame,
    lidar_path,
    rigid,
    slot_frame,
)
from multilica.sinks.text.log_lines import LogLine, pair_label
from multilica.sinks.text.markdown import decisions_markdown, markdown_table
from multilica.snapshot import LidarScans

_DROP_COLOURS: dict[str, Rgb] = {"too_near": VIOLATE, "too_far": MUTED, "moving": UNDECIDED}
_AXIS_LENGTH_M = 1.0
_NORMAL_LENGTH_M = 0.4
_NAME_HEIGHTS = 4
_NAME_SPACING_M = 1.2
RESIDUAL_SCALE_M = 0.05
"""Residual with the brightest colour: a few times the range noise of vehicle LiDARs."""
# The darkest colours of the scale can hardly be seen on the background.
_DARKEST = 0.15
_GRID_HALF_SIZE_M = 15.0
_GRID_SPACING_M = 2.5
_NODE_RADIUS = 12.0
_LABEL_RADIUS = 4.0
_CIRCLE_RADIUS = 160.0
_SURE_LINE, _UNCERTAIN_LINE = 0.5, 2.0
# Enough to see what a refused snapshot shows.
_REFUSED_POINTS = 5000


def log_input(scene: RerunScene, event: events.CalibrationStarted) -> None:
    """Log the raw clouds side by side, and the configuration."""
    scene.log_document(CONFIG, f"```toml\n{config_toml(event.config)}```")
    # Until an entity is logged, the viewer has it in a frame of its own below this one, and reports an error in each
    # view that finds no path from there.
    scene.stream.log(FRAMES, rigid(ROOT_FRAME, DISPLAY_FRAME), static=True)
    offsets_m = drawing.slot_offsets_m(scene.state)
    for lidar in event.snapshot.lidars:
        frame, offset_m = slot_frame(lidar.name), (0.0, offsets_m[lidar.name], 0.0)
        place = RigidTransform.from_xyz_rpy(DISPLAY_FRAME, frame, offset_m, (0.0, 0.0, 0.0))
        scene.stream.log(lidar_path(lidar.name, "slot"), rigid(frame, DISPLAY_FRAME, place), static=True)
        _log_sensor(scene, lidar.name, event.snapshot.names.index(lidar.name))
        count, limit = lidar.points_count, scene.limits.raw_points
        if count > limit:
            scene.log_line(LogLine("INFO", f"{lidar.name}: {limit:,} of {count:,} raw points are recorded"))
        _log_raw(scene, lidar, limit)


def log_refused(scene: RerunScene) -> None:
    """Log some raw points of a refused snapshot, which has no other clouds, if none were logged."""
    if scene.limits.raw_points == 0 and scene.state.snapshot is not None:
        for lidar in scene.state.snapshot.lidars:
            _log_raw(scene, lidar, _REFUSED_POINTS)


def _log_raw(scene: RerunScene, lidar: LidarScans, limit: int) -> None:
    path, frame = lidar_path(lidar.name, "raw"), lidar_frame(lidar.name)
    scene.log_points(path, frame, drawing.sample_returns(lidar, limit), scene.colour(lidar.name), limit)


def _name_pole_m(index: int, *, top: bool = False) -> Float32Array:
    """Return the line (1, 2, 3) from the LiDAR of an index to its name, in its own frame; at the top above all others.

    Names of neighbours differ in height, to be apart even if the sensors sit close together.
    """
    level = _NAME_HEIGHTS if top else index % _NAME_HEIGHTS
    return np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, _NAME_SPACING_M * (1 + level)]]], dtype=np.float32)


def _log_sensor(scene: RerunScene, lidar: str, index: int) -> None:
    start = [
        rr.TimeColumn(STEP_TIMELINE, sequence=[0]),
        rr.TimeColumn(ITERATION_TIMELINE, sequence=[0]),
        rr.TimeColumn(CLOCK_TIMELINE, timestamp=[np.datetime64(scene.started_ns, "ns")]),
        *([rr.TimeColumn(STOP_TIMELINE, sequence=[0])] if scene.state.stops else []),
    ]
    log_in_slot(scene, lidar, start)
    axes = rr.TransformAxes3D(_AXIS_LENGTH_M)
    scene.stream.log(lidar_path(lidar, "sensor"), rr.CoordinateFrame(lidar_frame(lidar)), axes, static=True)
    pole_m = _name_pole_m(index)
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
    strips = drawing.shown_field_of_view(scene.state, cloud.lidar)
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
        shown = drawing.sample_indices(len(features.points_m), scene.limits.normals)
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
    if state.snapshot is None or state.config is None:
        return
    reasons = sorted({reason for cloud in state.clouds.values() for reason in cloud.dropped_m})
    header = ("LiDAR", "returns", *reasons, "kept", "after thinning")
    rows = [
        (lidar.name, f"{lidar.points_count:,}", *_kept_cells(state.clouds.get(lidar.name), reasons))
        for lidar in state.snapshot.lidars
    ]
    limits = state.config.preprocess
    meanings = {
        "too_near": f"nearer than {limits.min_range_m:g} m, such as the vehicle's own body (`preprocess.min_range_m`)",
        "too_far": f"farther than {limits.max_range_m:g} m (`preprocess.max_range_m`)",
        "moving": "moved between frames: beams of other frames pass through its place, or none reaches it "
        "(`stillness.moving_clearance_m`)",
    }
    listed = "\n".join(f"- `{reason}`: {meanings.get(reason, '')}" for reason in reasons)
    scene.log_document(DROPPED_TABLE, f"# Dropped points\n\n{markdown_table(header, rows)}\n\n{listed}")


def _kept_cells(cloud: PreprocessedCloud | None, reasons: Sequence[str]) -> Sequence[str]:
    if cloud is None:
        return ("-",) * (len(reasons) + 2)
    dropped = (f"{len(cloud.dropped_m.get(reason, ())):,}" for reason in reasons)
    return (*dropped, f"{cloud.returns:,}", f"{len(cloud.points_m):,}" if cloud.returns else "**none**")


def log_residuals(scene: RerunScene, event: events.ResidualsMeasured) -> None:
    """Log the points of a LiDAR that others saw as well, coloured by their distance to the others' surfaces."""
    found = event.residuals
    rows = drawing.sample_indices(len(found.points_m), scene.limits.cloud_points)
    colours = heat_colours(_DARKEST + (1.0 - _DARKEST) * found.residual_m[rows] / RESIDUAL_SCALE_M)
    shown = rr.Points3D(found.points_m[rows].astype(np.float32), colors=colours, radii=rr.Radius.ui_points(2.0))
    scene.log_in(lidar_frame(found.lidar), lidar_path(found.lidar, "residual"), shown)


def log_movable(scene: RerunScene, event: events.MovableFound) -> None:
    """Log the points of a LiDAR on objects that could have moved; all its others are fixed."""
    rows = drawing.sample_indices(len(event.points_m), scene.limits.cloud_points)
    shown = rr.Points3D(event.points_m[rows].astype(np.float32), colors=[UNDECIDED], radii=rr.Radius.ui_points(2.5))
    scene.log_in(lidar_frame(event.lidar), lidar_path(event.lidar, "movable"), shown)


def log_merge_step(scene: RerunScene, event: events.MergeStepTaken) -> None:
    """Log the pairs of a merge step, the graph, and the group that grew."""
    for pose in event.poses:
        member, is_root = pose.source, pose.source == pose.target
        parent = slot_frame(member) if is_root else lidar_frame(pose.target)
        scene.log(lidar_path(member, "sensor"), rigid(lidar_frame(member), parent, None if is_root else pose))
    decisions, config = scene.state.decisions, scene.state.config
    by_evidence = config is None or config.verify.enabled
    scene.log_document(MERGE_STEPS, decisions_markdown(decisions, by_evidence=by_evidence))
    _log_graph(scene, decisions, by_evidence=by_evidence)


def _log_graph(scene: RerunScene, decisions: Sequence[MergeDecision], *, by_evidence: bool) -> None:
    """Log LiDARs on a circle; each pair is an edge through a small node with the figure that ranks it."""
    latest, merged = _latest_pairs(decisions), [decision.chosen for decision in decisions]
    angles = np.linspace(0.0, 2.0 * np.pi, len(scene.state.lidars), endpoint=False) - np.pi / 2.0
    circle = _CIRCLE_RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    places = dict(zip(scene.state.lidars, circle, strict=True))
    pairs = [pair for pair in latest if pair[0] in places and pair[1] in places]
    middles = [places[end] + drawing.EDGE_LABEL_SHARE * (places[start] - places[end]) for end, start in pairs]
    outcomes = {pair: _outcome(scene, latest[pair]) for pair in pairs}
    uncertain = {pair: ", uncertain" if latest[pair].uncertain else "" for pair in pairs}
    words = {pair: f"merged{uncertain[pair]}" if latest[pair] in merged else outcomes[pair] for pair in pairs}
    figures = {
        pair: f"evidence {latest[pair].evidence:z.1f}" if by_evidence else f"fitness {latest[pair].fitness:.2f}"
        for pair in pairs
    }
    nodes = rr.GraphNodes(
        node_ids=[*places, *(pair_label(*pair) for pair in pairs)],
        positions=[*places.values(), *middles],
        labels=[*places, *(f"{figures[pair]} {words[pair]}" for pair in pairs)],
        colors=[*map(scene.colour, places), *(VERDICT_COLOURS[outcomes[pair]] for pair in pairs)],
        radii=[_NODE_RADIUS] * len(places) + [_LABEL_RADIUS] * len(pairs),
        show_labels=True,
    )
    edges = [edge for pair in pairs for edge in ((pair[1], pair_label(*pair)), (pair_label(*pair), pair[0]))]
    scene.log(MERGE_GRAPH, nodes, rr.GraphEdges(edges=edges, graph_type="directed"))


def _latest_pairs(decisions: Sequence[MergeDecision]) -> dict[PairKey, MergeCandidate]:
    """Return the latest state of every pair so far, in name order; its merge, if it was merged."""
    seen = [one for decision in decisions for one in decision.candidates]
    merged = [decision.chosen for decision in decisions if decision.chosen is not None]
    latest = {frozenset((one.target, one.source)): one for one in (*seen, *merged)}
    return {(one.target, one.source): one for one in sorted(latest.values(), key=lambda one: (one.target, one.source))}


def _outcome(scene: RerunScene, pair: MergeCandidate) -> str:
    """Return the verdict of the latest registration of the two, single or of groups."""
    if pair.passes:
        return "accept"
    if pair.uncertain:
        return "uncertain"
    state, names = scene.state, {pair.target, pair.source}
    known = [*state.registrations.values(), *state.group_registrations]
    latest = next((each for each in reversed(known) if {each.target, each.source} == names), None)
    return "reject" if latest is None else latest.verdict.outcome


def log_outcome(scene: RerunScene) -> None:
    """Log every placed or uncertain LiDAR in the target's frame."""
    document = scene.state.document
    target = document.target
    if target in scene.state.lidars:
        scene.log(lidar_path(target, "sensor"), rigid(lidar_frame(target), slot_frame(target)))
    for lidar, pose in document.poses.items():
        if lidar != target:
            scene.log(lidar_path(lidar, "sensor"), rigid(lidar_frame(lidar), lidar_frame(target), pose))
            _log_uncertainty(scene, document, lidar)


def _log_uncertainty(scene: RerunScene, document: ResultDocument, lidar: str) -> None:
    """Log the enlarged ellipsoid of the position in the target's frame; the name of an uncertain LiDAR says so."""
    ellipsoid, scale = drawing.uncertainty_ellipsoid(document, lidar), drawing.ellipsoid_scale(document)
    if ellipsoid is None:
        return
    label = drawing.ellipsoid_label(document, lidar, scale)
    half_sizes_m, axes = ellipsoid
    shape = rr.Ellipsoids3D(
        centers=[axes.xyz_m],
        half_sizes=[scale * half_sizes_m],
        quaternions=[rr.Quaternion(xyzw=axes.quaternion_xyzw)],
        colors=[scene.colour(lidar)],
        line_radii=rr.Radius.ui_points(_UNCERTAIN_LINE if label else _SURE_LINE),
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
    scene.log_in(lidar_frame(document.target), lidar_path(lidar, "uncertainty"), shape)
    if label:
        pole_m = _name_pole_m(0, top=True)
        scene.log(lidar_path(lidar, "name"), rr.LineStrips3D.from_fields(strips=pole_m))
        tip = rr.Points3D.from_fields(positions=pole_m[0, 1:], labels=[label])
        scene.log(lidar_path(lidar, "name", "tip"), tip)


def log_ground(scene: RerunScene, event: events.GroundEstimated) -> None:
    """Log the ground plane as a grid around the point below the target LiDAR."""
    if event.ground is None or not scene.state.target:
        return
    strips = rr.LineStrips3D(_grid(event.ground), colors=[MUTED], radii=rr.Radius.ui_points(0.5))
    scene.log_in(lidar_frame(scene.state.target), GROUND, strips)


def _grid(ground: GroundPlane) -> npt.NDArray[np.float32]:
    """Return segments (K, 2, 3) in the target's frame."""
    forward, left = ground.T_base_target.rotation[0], ground.T_base_target.rotation[1]
    centre = -ground.offset_m * ground.normal
    ticks = np.arange(-_GRID_HALF_SIZE_M, _GRID_HALF_SIZE_M + _GRID_SPACING_M, _GRID_SPACING_M)
    ends = np.array([-_GRID_HALF_SIZE_M, _GRID_HALF_SIZE_M])
    along = centre + ticks[:, None, None] * left + ends[None, :, None] * forward
    across = centre + ticks[:, None, None] * forward + ends[None, :, None] * left
    return np.concatenate([along, across]).astype(np.float32)
