# SPDX-License-Identifier: Apache-2.0
"""Which LiDARs were compared, and what came of it, as a graph."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from multilica.sinks.palette import Rgb
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.rig_scene import hex_colour

__all__ = ["GraphEdge", "GraphNode", "MergeGraph", "merge_graph"]

_SIZE = (640.0, 420.0)
_RADII = (220.0, 150.0)
_ALONG = 0.4
"""Where on an edge its figure stands; off the middle, where the diagonals of a square meet."""


@dataclass(frozen=True, slots=True)
class GraphNode:
    """A LiDAR at its place in the drawing."""

    name: str
    x: float
    y: float
    colour: str
    placed: bool
    target: bool


@dataclass(frozen=True, slots=True)
class GraphEdge:
    """A pair that was registered.

    Args:
        start, end: source and target.
        outcome: ``merged``, or the verdict's.
        label: the fitness.
    """

    start: GraphNode
    end: GraphNode
    outcome: str
    label: str

    @property
    def label_at(self) -> tuple[float, float]:
        """Where the figure stands."""
        return (
            self.end.x + _ALONG * (self.start.x - self.end.x),
            self.end.y + _ALONG * (self.start.y - self.end.y),
        )


@dataclass(frozen=True, slots=True)
class MergeGraph:
    """Nodes on an ellipse in name order."""

    size: tuple[float, float]
    nodes: tuple[GraphNode, ...]
    edges: tuple[GraphEdge, ...]


def merge_graph(contents: ReportContents, colours: Mapping[str, Rgb]) -> MergeGraph:
    """The drawing of all pairs; those over which the merge went stand out."""
    document = contents.document
    nodes = {name: _node(contents, index, colours[name]) for index, name in enumerate(contents.names)}
    chosen = [decision["chosen"] for decision in document["decisions"] if decision["chosen"] is not None]
    merged = {frozenset((one["target"], one["source"])) for one in chosen}
    edges = [_edge(nodes, pair, merged) for pair in document["pairs"]]
    return MergeGraph(_SIZE, tuple(nodes.values()), tuple(edges))


def _node(contents: ReportContents, index: int, colour: Rgb) -> GraphNode:
    name = contents.names[index]
    angle = 2.0 * math.pi * index / len(contents.names) - 0.75 * math.pi
    return GraphNode(
        name,
        round(_SIZE[0] / 2.0 + _RADII[0] * math.cos(angle), 1),
        round(_SIZE[1] / 2.0 + _RADII[1] * math.sin(angle), 1),
        hex_colour(colour),
        placed=contents.document["lidars"][name]["placed"],
        target=name == contents.target,
    )


def _edge(nodes: Mapping[str, GraphNode], pair: Mapping[str, Any], merged: set[frozenset[str]]) -> GraphEdge:
    target, source = pair["target"], pair["source"]
    outcome = "merged" if frozenset((target, source)) in merged else str(pair["verdict"]["outcome"])
    return GraphEdge(nodes[source], nodes[target], outcome, f"{pair['fitness']:.2f}")
