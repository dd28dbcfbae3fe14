# SPDX-License-Identifier: Apache-2.0
"""Pairs of a result that concern a LiDAR that is not placed."""

from collections.abc import Sequence

from multilica.diagnosis.causes import REASON_WORDS, by_weight
from multilica.diagnosis.explanation import DecisivePair
from multilica.results.document import PairEntry, ResultDocument

_RANK = {"accept": 0, "uncertain": 1, "undecided": 2, "reject": 3}


def group_of(document: ResultDocument, lidar: str) -> tuple[str, ...]:
    """Return the LiDARs in the merge group of this one after the last step, itself among them."""
    groups = document.decisions[-1].groups if document.decisions else ()
    return next((group for group in groups if lidar in group), (lidar,))


def crossing_pairs(document: ResultDocument, lidar: str) -> list[PairEntry]:
    """Return the pairs between the LiDAR's group and the other LiDARs, the one nearest to acceptance first."""
    members = {*group_of(document, lidar)}
    crossing = [pair for pair in document.pairs if len(pair.names & members) == 1]
    return sorted(crossing, key=lambda pair: (_RANK[pair.verdict.outcome], -pair.evidence, pair.target, pair.source))


def decisive_pair(pair: PairEntry) -> DecisivePair:
    """Describe a pair: the reason that names the cause in full, the others by name."""
    texts = {reason.code: _in_one_clause(reason.text) for reason in pair.verdict.reasons}
    first, *others = by_weight(texts) or ("",)
    found = texts.get(first, "the pair itself was accepted")
    also = f" Also: {', '.join(REASON_WORDS.get(code, code) for code in others)}." if others else ""
    return DecisivePair(pair.target, pair.source, tuple(texts), f"{_named(pair)}: {found}.{also}")


def _named(pair: PairEntry) -> str:
    return f"{pair.source} against {pair.target} (pair fitness {pair.fitness or 0.0:.3f})"


def contested_places(document: ResultDocument, lidar: str) -> tuple[DecisivePair, DecisivePair] | None:
    """Return the accepted pairs that put the LiDAR at different places, the one with more evidence first."""
    contested = document.lidars[lidar].contested
    if contested is None:
        return None
    pairs = {pair.key: pair for pair in document.pairs}
    first, other = pairs[contested.pair], pairs[contested.other]
    sentence = (
        f"{_named(first)} and {_named(other)} are each accepted, but place it {contested.distance_m:.2f} m and "
        f"{contested.angle_deg:.0f} deg apart."
    )
    return DecisivePair(first.target, first.source, (), sentence), decisive_pair(other)


def merge_refusal(document: ResultDocument, lidar: str) -> str:
    """Return why the last merge step refused the LiDAR's group; empty if it did not try it."""
    members = {*group_of(document, lidar)}
    candidates = document.decisions[-1].candidates if document.decisions else ()
    reasons = (one.reason for one in candidates if len(one.names & members) == 1 and one.reason)
    reason = next(reasons, "")
    return f"Against the merged rig: {_in_one_clause(reason)}." if reason else ""


def _in_one_clause(text: str) -> str:
    return text.replace("; ", ", ")


def next_best_sentence(pairs: Sequence[PairEntry]) -> str:
    """Describe the second pose of the decisive pair, else the next pair; empty if there is neither."""
    if pairs and len(pairs[0].registrations) > 1:
        first, *others = pairs[0].registrations
        second = max(others, key=lambda other: other.evidence or 0.0)
        return (
            f"another pose of {pairs[0].source} against {pairs[0].target} has an evidence of "
            f"{second.evidence or 0.0:z.1f} (the decisive pose {first.evidence or 0.0:z.1f}). At this pose "
            f"{second.agree:,} points agree and {second.violate:,} lie in proven-empty space."
        )
    return decisive_pair(pairs[1]).sentence if len(pairs) > 1 else ""
