# SPDX-License-Identifier: Apache-2.0
"""Merge steps as a graph with a growing cloud."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.results import MergeCandidate, MergeDecision, PairKey
from multilica.sinks.drawing.palette import VERDICT_COLOURS
from multilica.sinks.drawing.primitives import EDGE_LABEL_SHARE
from multilica.sinks.rerun.scene import RerunScene, rigid
from multilica.sinks.rerun.tree import MERGE_GRAPH, MERGE_STEPS, lidar_frame, lidar_path, slot_frame
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.run_summary import decisions_markdown

__all__ = ["log_merge_step"]

_NODE_RADIUS = 12.0
_LABEL_RADIUS = 4.0
_CIRCLE_RADIUS = 160.0


def log_merge_step(scene: RerunScene, event: events.MergeStepTaken) -> None:
    """Log the pairs of a merge step, the graph, and the group that grew."""
    for pose in event.poses:
        member, root = pose.source, pose.target
        if member != root:
            scene.log(lidar_path(member, "sensor"), rigid(lidar_frame(member), lidar_frame(root), pose))
        else:
            scene.log(lidar_path(member, "sensor"), rigid(lidar_frame(member), slot_frame(member)))
    scene.log_document(MERGE_STEPS, decisions_markdown(scene.state.decisions))
    _log_graph(scene, scene.state.decisions)


def _log_graph(scene: RerunScene, decisions: Sequence[MergeDecision]) -> None:
    """Log LiDARs on a circle; each pair is an edge through a small node with its fitness."""
    latest = _latest_pairs(decisions)
    places = _places(scene.state.lidars)
    pairs = [pair for pair in latest if pair[0] in places and pair[1] in places]
    nodes = rr.GraphNodes(
        node_ids=[*places, *(pair_label(*pair) for pair in pairs)],
        positions=[*places.values(), *(_along(places, pair) for pair in pairs)],
        labels=[*places, *(_label(scene, latest[pair], decisions) for pair in pairs)],
        colors=[
            *(scene.colour(name) for name in places),
            *(VERDICT_COLOURS[_outcome(scene, latest[pair])] for pair in pairs),
        ],
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


def _label(scene: RerunScene, pair: MergeCandidate, decisions: Sequence[MergeDecision]) -> str:
    """Return the fitness with the verdict, or with "merged" for a pair that a step chose."""
    merged = any(pair == decision.chosen for decision in decisions)
    return f"{pair.fitness:.2f} {'merged' if merged else _outcome(scene, pair)}"


def _outcome(scene: RerunScene, pair: MergeCandidate) -> str:
    """Return the verdict of the latest registration of the two, single or of groups."""
    if pair.passes:
        return "accept"
    state, names = scene.state, {pair.target, pair.source}
    known = [*state.registrations.values(), *state.group_registrations]
    latest = next((each for each in reversed(known) if {each.target, each.source} == names), None)
    return "reject" if latest is None else latest.verdict.outcome


def _places(lidars: Sequence[str]) -> dict[str, npt.NDArray[np.float64]]:
    angles = np.linspace(0.0, 2.0 * np.pi, len(lidars), endpoint=False) - np.pi / 2.0
    return {
        name: _CIRCLE_RADIUS * np.array([np.cos(angle), np.sin(angle)])
        for name, angle in zip(lidars, angles, strict=True)
    }


def _along(places: Mapping[str, npt.NDArray[np.float64]], pair: PairKey) -> npt.NDArray[np.float64]:
    target, source = places[pair[0]], places[pair[1]]
    return np.asarray(target + EDGE_LABEL_SHARE * (source - target))
