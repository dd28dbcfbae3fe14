# SPDX-License-Identifier: Apache-2.0
"""The poses of one pair with what speaks for each, as markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from multilica.results import PRIOR, Assessment, Hypothesis, PairKey, hypothesis_label
from multilica.sinks.markdown import markdown_table, thousandths
from multilica.sinks.narration import pair_label
from multilica.sinks.run_story import RunStory

__all__ = ["pair_scores_markdown"]

Shown = Assessment | Hypothesis

_HEADER = ("pose", "step", "matches", "judged", "agree", "violate", "occluded", "evidence", "fitness", "RMSE m")


def pair_scores_markdown(story: RunStory, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]) -> str:
    """The search and the verdict in words, then a row per hypothesis, the most believable first.

    Args:
        shown: what the view shows at this step.
        shown_at: per hypothesis, and per judgement of one, the step at which it is seen.
    """
    legend = (
        "Green points lie on surfaces that the other LiDAR measured, red ones in space that its beams passed "
        "through, grey ones behind what it saw; dark ones it could not see. Both sides are judged. Go to a pose's "
        "step on the timeline `step` to see it."
    )
    parts = (
        f"# {pair_label(*pair)}",
        _verdict(story, pair),
        _search(story, pair),
        _table(story, pair, shown, shown_at),
    )
    return "\n\n".join((*(part for part in parts if part), legend))


def _verdict(story: RunStory, pair: PairKey) -> str:
    found = story.registrations.get(pair)
    if found is None:
        return ""
    return f"**{found.verdict.outcome}**" + "".join(f"\n- {reason.text}" for reason in found.verdict.reasons)


def _search(story: RunStory, pair: PairKey) -> str:
    coarse = story.coarse.get(pair)
    if coarse is None:
        return ""
    graph = (
        f"consistency graph of {coarse.graph_nodes:,} matches with {coarse.graph_edges:,} edges"
        if coarse.graph_nodes
        else "no consistency graph (the solver builds none)"
    )
    return f"{len(story.matches.get(pair, ())):,} matches; {graph}; hypotheses: {len(coarse.hypotheses)}"


def _table(story: RunStory, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]) -> str:
    hypotheses = story.coarse[pair].hypotheses if pair in story.coarse else ()
    judged = _judged(story, pair)
    rows: list[tuple[Shown, str, str, tuple[str, ...]]] = [
        (one, one.label, _matches(hypotheses, one.hypothesis), _scores(how, one)) for how, one in judged
    ]
    seen = {one.hypothesis for _, one in judged}
    rows += [
        (one, hypothesis_label(index, one.origin), _matches(hypotheses, index), ("-",) * 7)
        for index, one in enumerate(hypotheses)
        if index not in seen
    ]
    lines = [(_name(label), str(shown_at.get(one, "-")), matches, *scores) for one, label, matches, scores in rows]
    marked = [
        tuple(f"**{cell}**" for cell in line) if row[0] is shown else line
        for row, line in zip(rows, lines, strict=True)
    ]
    return markdown_table(_HEADER, marked) if marked else ""


def _judged(story: RunStory, pair: PairKey) -> list[tuple[str, Assessment]]:
    """The finely registered poses, then those that only had a short GICP, each by evidence."""
    found = story.registrations.get(pair)
    finely = found.assessments if found is not None else ()
    taken = {one.hypothesis for one in finely}
    roughly = [one for one in story.assessments.get(pair, ()) if one.hypothesis not in taken]
    return [*(("fine", one) for one in finely), *(("rough", one) for one in roughly)]


def _name(label: str) -> str:
    return label if label == PRIOR else f"#{label}"


def _matches(hypotheses: Sequence[Hypothesis], index: int) -> str:
    return f"{hypotheses[index].score:g}" if 0 <= index < len(hypotheses) else "-"


def _scores(how: str, one: Assessment) -> tuple[str, ...]:
    beams = one.testimony
    counts = (f"{beams.agree:,}", f"{beams.violate:,}", f"{beams.occluded:,}", f"{beams.evidence:,.0f}")
    return (how, *counts, thousandths(one.fitness), thousandths(one.rmse_m))
