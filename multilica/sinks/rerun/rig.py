# SPDX-License-Identifier: Apache-2.0
"""The rig in a recording, from the first merge step to the ground plane."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.results import GroundPlane, MergeCandidate, MergeDecision, PairKey
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.palette import MUTED, VERDICT_COLOURS
from multilica.sinks.drawing.shapes import EDGE_LABEL_SHARE, ellipsoid_label, ellipsoid_scale, uncertainty_ellipsoid
from multilica.sinks.rerun.entity_paths import GROUND, MERGE_GRAPH, MERGE_STEPS, lidar_frame, lidar_path, slot_frame
from multilica.sinks.rerun.input import name_pole_m
from multilica.sinks.rerun.scene import RerunScene, rigid
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import decisions_markdown

_GRID_HALF_SIZE_M = 15.0
_GRID_SPACING_M = 2.5
_NODE_RADIUS = 12.0
_LABEL_RADIUS = 4.0
_CIRCLE_RADIUS = 160.0
_SURE_LINE, _UNCERTAIN_LINE = 0.5, 2.0


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
    middles = [places[end] + EDGE_LABEL_SHARE * (places[start] - places[end]) for end, start in pairs]
    outcomes = {pair: _outcome(scene, latest[pair]) for pair in pairs}
    words = {pair: _words(latest[pair], outcomes[pair], merged=latest[pair] in merged) for pair in pairs}
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


def _words(pair: MergeCandidate, outcome: str, *, merged: bool) -> str:
    if merged:
        return "merged, uncertain" if pair.uncertain else "merged"
    return outcome


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
    ellipsoid, scale = uncertainty_ellipsoid(document, lidar), ellipsoid_scale(document)
    if ellipsoid is None:
        return
    label = ellipsoid_label(document, lidar, scale)
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
        pole_m = name_pole_m(0, top=True)
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
