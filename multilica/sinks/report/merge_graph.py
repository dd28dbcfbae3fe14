# SPDX-License-Identifier: Apache-2.0
"""Merge graph of a report."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from multilica.results.document import PairEntry
from multilica.sinks.drawing.palette import Rgb, hex_colour
from multilica.sinks.drawing.primitives import EDGE_LABEL_SHARE
from multilica.sinks.report.contents import ReportContents

__all__ = ["GraphEdge", "GraphNode", "MergeGraph", "merge_graph"]

_SIZE = (640.0, 420.0)
_RADII = (220.0, 150.0)


@dataclass(frozen=True, slots=True)
class GraphNode:
    """A LiDAR in the drawing."""

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
        """Return the position of the label."""
        return (
            self.end.x + EDGE_LABEL_SHARE * (self.start.x - self.end.x),
            self.end.y + EDGE_LABEL_SHARE * (self.start.y - self.end.y),
        )


@dataclass(frozen=True, slots=True)
class MergeGraph:
    """Nodes on an ellipse in name order."""

    size: tuple[float, float]
    nodes: tuple[GraphNode, ...]
    edges: tuple[GraphEdge, ...]


def merge_graph(contents: ReportContents, colours: Mapping[str, Rgb]) -> MergeGraph:
    """Lay out all pairs as a graph that marks the merged ones."""
    document = contents.document
    nodes = {name: _node(contents, index, colours[name]) for index, name in enumerate(contents.names)}
    merged = {decision.chosen.names for decision in document.decisions if decision.chosen is not None}
    edges = [_edge(nodes, pair, merged) for pair in document.pairs]
    return MergeGraph(_SIZE, tuple(nodes.values()), tuple(edges))


def _node(contents: ReportContents, index: int, colour: Rgb) -> GraphNode:
    name = contents.names[index]
    angle = 2.0 * math.pi * index / len(contents.names) - 0.75 * math.pi
    return GraphNode(
        name,
        round(_SIZE[0] / 2.0 + _RADII[0] * math.cos(angle), 1),
        round(_SIZE[1] / 2.0 + _RADII[1] * math.sin(angle), 1),
        hex_colour(colour),
        placed=contents.document.lidars[name].placed,
        target=name == contents.target,
    )


def _edge(nodes: Mapping[str, GraphNode], pair: PairEntry, merged: set[frozenset[str]]) -> GraphEdge:
    outcome = "merged" if pair.names in merged else pair.verdict.outcome
    return GraphEdge(nodes[pair.source], nodes[pair.target], outcome, f"{pair.fitness or 0.0:.2f}")
