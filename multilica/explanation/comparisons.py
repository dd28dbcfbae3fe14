# SPDX-License-Identifier: Apache-2.0
"""The pairs of a result, as far as they speak of a LiDAR that is not placed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from multilica.explanation.causes import REASON_WORDS, by_weight
from multilica.explanation.explanation import Comparison

__all__ = [
    "Document",
    "comparisons_of",
    "decisive_comparison",
    "group_of",
    "next_best_sentence",
    "weighed_in_merge",
]

Document = Mapping[str, Any]
_RANK = {"accept": 0, "undecided": 1, "reject": 2}


def group_of(document: Document, lidar: str) -> tuple[str, ...]:
    """The LiDARs that were joined to this one in the end, itself among them."""
    groups = document["decisions"][-1]["groups"] if document["decisions"] else []
    return tuple(next((group for group in groups if lidar in group), [lidar]))


def comparisons_of(document: Document, lidar: str) -> list[Document]:
    """Pairs that could have joined the LiDAR's group to others, the one that came closest first."""
    members = set(group_of(document, lidar))
    crossing = [pair for pair in document["pairs"] if len({pair["target"], pair["source"]} & members) == 1]
    return sorted(crossing, key=_closeness)


def _closeness(pair: Document) -> tuple[Any, ...]:
    return (_RANK.get(pair["verdict"]["outcome"], len(_RANK)), -_evidence(pair), pair["target"], pair["source"])


def _evidence(pair: Document) -> float:
    assessments = pair["assessments"]
    return float((assessments[0]["evidence"] if assessments else pair["fitness"]) or 0.0)


def decisive_comparison(pair: Document) -> Comparison:
    """That pair with what spoke against it: the reason that names the cause in full, the others by name."""
    target, source = str(pair["target"]), str(pair["source"])
    texts = {str(reason["code"]): _in_one_clause(reason["text"]) for reason in pair["verdict"]["reasons"]}
    first, *others = by_weight(texts) or ("",)
    found = texts.get(first, "it was accepted by itself")
    besides = f"; besides: {', '.join(REASON_WORDS.get(code, code) for code in others)}" if others else ""
    sentence = f"{source} against {target} (fitness {pair['fitness']:.2f}): {found}{besides}."
    return Comparison(target, source, tuple(texts), sentence)


def weighed_in_merge(document: Document, lidar: str) -> str:
    """What the last merge step said of the LiDAR's group against another one; empty where there was no such step."""
    if not document["decisions"]:
        return ""
    members = set(group_of(document, lidar))
    candidates = document["decisions"][-1]["candidates"]
    own = (one for one in candidates if len({one["target"], one["source"]} & members) == 1 and one["reason"])
    best = next(own, None)
    return "" if best is None else f"against the rig as merged by then: {_in_one_clause(best['reason'])}"


def _in_one_clause(text: str) -> str:
    return text.replace("; ", ", ")


def next_best_sentence(pairs: Sequence[Document]) -> str:
    """The second pose of the decisive pair, else the best of the next pair; empty if there is neither."""
    if not pairs:
        return ""
    decisive = pairs[0]
    if len(decisive["assessments"]) > 1:
        first, second = decisive["assessments"][:2]
        return (
            f"another pose of {decisive['source']} against {decisive['target']}, which rests on "
            f"{second['evidence']:,.0f} distinctive points, the decisive one on {first['evidence']:,.0f} "
            f"({second['agree']:,} points agree, {second['violate']:,} stand in empty space)."
        )
    return decisive_comparison(pairs[1]).sentence if len(pairs) > 1 else ""
