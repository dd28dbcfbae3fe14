# SPDX-License-Identifier: Apache-2.0
"""The merge steps as a graph and as a growing cloud."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica import events
from multilica.results import MergeCandidate, MergeDecision, PairKey
from multilica.sinks.narration import pair_label
from multilica.sinks.palette import VERDICT_COLOURS
from multilica.sinks.rerun_scene import Scene, rigid
from multilica.sinks.rerun_tree import MERGE_CANDIDATES, MERGE_GRAPH, lidar_frame, lidar_path, slot_frame
from multilica.sinks.run_summary import decisions_markdown

__all__ = ["log_merge_step"]

_NODE_RADIUS = 12.0
_LABEL_RADIUS = 4.0
_CIRCLE_RADIUS = 160.0
_LABEL_POSITION = 0.4
"""Share of the way along an edge; off the middle, where the diagonals of a square would meet."""


def log_merge_step(scene: Scene, event: events.MergeStepTaken) -> None:
    """The candidates, the graph, and the group that grew in its root's place."""
    for pose in event.poses:
        member, root = pose.source, pose.target
        if member != root:
            scene.log(lidar_path(member, "sensor"), rigid(lidar_frame(member), lidar_frame(root), pose))
        else:
            scene.log(lidar_path(member, "sensor"), rigid(lidar_frame(member), slot_frame(member)))
    scene.log_document(MERGE_CANDIDATES, decisions_markdown(scene.story.decisions))
    _log_graph(scene, scene.story.decisions)


def _log_graph(scene: Scene, decisions: Sequence[MergeDecision]) -> None:
    """LiDARs on a circle; each comparison is an edge through a small node with its fitness."""
    candidates = _latest_candidates(decisions)
    places = _places(scene.story.lidars)
    pairs = [pair for pair in candidates if pair[0] in places and pair[1] in places]
    nodes = rr.GraphNodes(
        node_ids=[*places, *(pair_label(*pair) for pair in pairs)],
        positions=[*places.values(), *(_along(places, pair) for pair in pairs)],
        labels=[*places, *(_label(scene, candidates[pair], decisions) for pair in pairs)],
        colors=[
            *(scene.colour(name) for name in places),
            *(VERDICT_COLOURS[_outcome(scene, candidates[pair])] for pair in pairs),
        ],
        radii=[_NODE_RADIUS] * len(places) + [_LABEL_RADIUS] * len(pairs),
        show_labels=True,
    )
    edges = [edge for pair in pairs for edge in ((pair[1], pair_label(*pair)), (pair_label(*pair), pair[0]))]
    scene.log(MERGE_GRAPH, nodes, rr.GraphEdges(edges=edges, graph_type="directed"))


def _latest_candidates(decisions: Sequence[MergeDecision]) -> dict[PairKey, MergeCandidate]:
    """Every comparison so far as it was last weighed, in name order; that by which it was merged, if it was."""
    weighed = [one for decision in decisions for one in decision.candidates]
    merged = [decision.chosen for decision in decisions if decision.chosen is not None]
    latest = {frozenset((one.target, one.source)): one for one in (*weighed, *merged)}
    return {(one.target, one.source): one for one in sorted(latest.values(), key=lambda one: (one.target, one.source))}


def _label(scene: Scene, candidate: MergeCandidate, decisions: Sequence[MergeDecision]) -> str:
    """Fitness with the verdict; merged is what a step chose."""
    merged = any(candidate == decision.chosen for decision in decisions)
    return f"{candidate.fitness:.2f} {'merged' if merged else _outcome(scene, candidate)}"


def _outcome(scene: Scene, candidate: MergeCandidate) -> str:
    """The verdict on the latest registration of the two, single or of merged clouds."""
    if candidate.passes:
        return "accept"
    story, names = scene.story, {candidate.target, candidate.source}
    known = [*story.registrations.values(), *story.merged_registrations]
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
    return np.asarray(target + _LABEL_POSITION * (source - target))
