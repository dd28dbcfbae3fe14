# SPDX-License-Identifier: Apache-2.0
"""Figures of all pairs at once, target in rows, source in columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import PairRegistration
from multilica.sinks.markdown import markdown_table
from multilica.sinks.narration import pair_label
from multilica.sinks.run_story import RunStory

__all__ = ["PairMatrix", "coverage_matrix", "coverage_of", "fitness_matrix", "pair_figures_markdown", "verdict_matrix"]

_VERDICTS = ("accept", "undecided", "reject")


@dataclass(frozen=True, slots=True, eq=False)
class PairMatrix:
    """A figure per registered pair.

    Args:
        names: LiDARs in order.
        values: (N, N), NaN where no pair was registered.
        texts: per (row, column) what to write there.
    """

    names: tuple[str, ...]
    values: FloatArray
    texts: Mapping[tuple[int, int], str]


def fitness_matrix(story: RunStory) -> PairMatrix:
    """Source points near the target's cloud, as a share of all."""
    return _matrix(story, lambda pair: pair.fitness, lambda pair: f"{pair.fitness:.2f}")


def coverage_matrix(story: RunStory) -> PairMatrix:
    """See `coverage_of`; without verification nothing is known."""
    return _matrix(story, coverage_of, lambda pair: f"{coverage_of(pair):.2f}")


def verdict_matrix(story: RunStory) -> PairMatrix:
    """0 accept, 1 undecided, 2 reject."""
    return _matrix(story, lambda pair: float(_VERDICTS.index(pair.verdict.outcome)), lambda pair: pair.verdict.outcome)


def coverage_of(pair: PairRegistration) -> float:
    """Points on surfaces that the other side measured, as a share of those in its field of view; NaN if unknown."""
    if not pair.assessments:
        return float("nan")
    beams = pair.assessments[0].testimony
    covered = beams.agree + beams.violate + beams.occluded
    return beams.agree / covered if covered else 0.0


def pair_figures_markdown(story: RunStory) -> str:
    """A row per pair."""
    header = ("pair", "matches", "graph nodes", "graph edges", "fitness", "coverage", "violate", "verdict", "reasons")
    note = (
        "Fitness: source points near the target's cloud. Coverage: judged points on surfaces that the other LiDAR "
        "measured, of those in its view. Target in rows, source in columns."
    )
    return f"# Pairs\n\n{markdown_table(header, _rows(story))}\n\n{note}"


def _rows(story: RunStory) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for pair in story.pairs:
        coarse, found = story.coarse.get(pair), story.registrations.get(pair)
        nodes, edges = (coarse.graph_nodes, coarse.graph_edges) if coarse is not None else (0, 0)
        counts = (f"{len(story.matches.get(pair, ())):,}", f"{nodes:,}", f"{edges:,}")
        rows.append((pair_label(*pair), *counts, *_figures(found)))
    return rows


def _figures(found: PairRegistration | None) -> Sequence[str]:
    if found is None:
        return ("-", "-", "-", "no pose", "-")
    reasons = ", ".join(reason.code.replace("_", " ") for reason in found.verdict.reasons) or "-"
    violate = f"{found.assessments[0].testimony.violation_share:.1%}" if found.assessments else "-"
    return (f"{found.fitness:.3f}", f"{coverage_of(found):.3f}", violate, found.verdict.outcome, reasons)


def _matrix(
    story: RunStory, value: Callable[[PairRegistration], float], text: Callable[[PairRegistration], str]
) -> PairMatrix:
    index = {name: row for row, name in enumerate(story.lidars)}
    values, texts = np.full((len(index), len(index)), np.nan), {}
    for pair in story.registrations.values():
        cell = (index[pair.target], index[pair.source])
        values[cell], texts[cell] = value(pair), text(pair)
    return PairMatrix(story.lidars, values, texts)
