# SPDX-License-Identifier: Apache-2.0
"""Figures of all pairs as markdown."""

from collections.abc import Sequence

from multilica.results import PairKey, PairRegistration
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import markdown_table

__all__ = ["coverage_of", "pair_figures_markdown"]

_HEADER = ("pair", "matches", "graph nodes", "graph edges", "fitness", "coverage", "violate", "verdict", "reasons")
_NOTE = (
    "Fitness: share of source points near the target's cloud. Coverage: share of agreeing points among those in the "
    "other LiDAR's view. Matrices have the target in rows, the source in columns."
)


def coverage_of(pair: PairRegistration) -> float:
    """Return the share of agreeing points among those in the other LiDAR's view; NaN without verification."""
    if not pair.registrations:
        return float("nan")
    beams = pair.registrations[0].visibility
    covered = beams.agree + beams.violate + beams.occluded
    return beams.agree / covered if covered else 0.0


def pair_figures_markdown(state: RunState) -> str:
    """Tabulate the figures of every pair."""
    return f"# Pairs\n\n{markdown_table(_HEADER, [_row(state, pair) for pair in state.pairs])}\n\n{_NOTE}"


def _row(state: RunState, pair: PairKey) -> Sequence[str]:
    coarse, found = state.coarse.get(pair), state.registrations.get(pair)
    nodes, edges = (coarse.graph_nodes, coarse.graph_edges) if coarse is not None else (0, 0)
    counts = (pair_label(*pair), f"{len(state.matches.get(pair, ())):,}", f"{nodes:,}", f"{edges:,}")
    if found is None:
        return (*counts, "-", "-", "-", "no pose", "-")
    reasons = ", ".join(reason.code.replace("_", " ") for reason in found.verdict.reasons) or "-"
    violate = f"{found.registrations[0].visibility.violation_share:.1%}" if found.registrations else "-"
    return (*counts, f"{found.fitness:.3f}", f"{coverage_of(found):.3f}", violate, found.verdict.outcome, reasons)
