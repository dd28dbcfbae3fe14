# SPDX-License-Identifier: Apache-2.0
"""Scores of one pair's poses as markdown."""

from collections.abc import Mapping, Sequence

from multilica.results import PRIOR, Hypothesis, PairKey, Registration, hypothesis_label
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import markdown_table, thousandths

__all__ = ["pair_scores_markdown"]

Shown = Registration | Hypothesis

_HEADER = ("pose", "step", "matches", "GICP", "agree", "violate", "occluded", "evidence", "fitness", "RMSE m")
_LEGEND = (
    "Points of both LiDARs by what the other one's beams prove: green lie on a measured surface, red in proven-empty "
    "space, grey behind a surface, dark out of view. To see a pose, go to its step on the timeline `step`."
)


def pair_scores_markdown(state: RunState, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]) -> str:
    """Describe the verdict and the search; add a row per pose, the one with the most evidence first.

    Args:
        shown: the pose that the view shows at this step; its row is bold.
        shown_at: the step at which each pose is shown.
    """
    parts = (
        f"# {pair_label(*pair)}",
        _verdict(state, pair),
        _search(state, pair),
        _table(state, pair, shown, shown_at),
    )
    return "\n\n".join((*(part for part in parts if part), _LEGEND))


def _verdict(state: RunState, pair: PairKey) -> str:
    found = state.registrations.get(pair)
    if found is None:
        return ""
    return f"**{found.verdict.outcome}**" + "".join(f"\n- {reason.text}" for reason in found.verdict.reasons)


def _search(state: RunState, pair: PairKey) -> str:
    coarse = state.coarse.get(pair)
    if coarse is None:
        return ""
    graph = f"consistency graph: {coarse.graph_nodes:,} nodes, {coarse.graph_edges:,} edges; "
    return (
        f"{len(state.matches.get(pair, ())):,} matches; {graph if coarse.graph_nodes else ''}"
        f"hypotheses: {len(coarse.hypotheses)}"
    )


def _table(state: RunState, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]) -> str:
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    scored = _scored(state, pair)
    rows: list[tuple[Shown, str, int, tuple[str, ...]]] = [
        (one, one.label, one.hypothesis, _scores(how, one)) for how, one in scored
    ]
    rows += [
        (one, hypothesis_label(index, one.origin), index, ("-",) * 7)
        for index, one in enumerate(hypotheses)
        if index not in {each.hypothesis for _, each in scored}
    ]
    lines = []
    for one, label, index, scores in rows:
        name = label if label == PRIOR else f"#{label}"
        matches = f"{hypotheses[index].score:g}" if 0 <= index < len(hypotheses) else "-"
        line = (name, str(shown_at.get(one, "-")), matches, *scores)
        lines.append(tuple(f"**{cell}**" for cell in line) if one is shown else line)
    return markdown_table(_HEADER, lines) if lines else ""


def _scored(state: RunState, pair: PairKey) -> Sequence[tuple[str, Registration]]:
    """Return the poses after full GICP, then those after a short one, each by evidence."""
    found = state.registrations.get(pair)
    full = found.registrations if found is not None else ()
    known = {one.hypothesis for one in full}
    short = [one for one in state.verified.get(pair, ()) if one.hypothesis not in known]
    return [*(("full", one) for one in full), *(("short", one) for one in short)]


def _scores(how: str, one: Registration) -> tuple[str, ...]:
    beams = one.visibility
    counts = (f"{beams.agree:,}", f"{beams.violate:,}", f"{beams.occluded:,}", f"{beams.evidence:z,.0f}")
    return (how, *counts, thousandths(one.fitness), thousandths(one.rmse_m))
