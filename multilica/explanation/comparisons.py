# SPDX-License-Identifier: Apache-2.0
"""The pairs of a result, as far as they speak of a LiDAR that is not placed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from multilica.explanation.explanation import Comparison

__all__ = ["Document", "comparisons_of", "decisive_comparison", "group_of", "next_best_sentence"]

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
    """That pair with what spoke against it."""
    target, source = str(pair["target"]), str(pair["source"])
    reasons = pair["verdict"]["reasons"]
    found = "; ".join(reason["text"].replace("; ", ", ") for reason in reasons) or "it was accepted by itself"
    sentence = f"{source} against {target} (fitness {pair['fitness']:.2f}): {found}."
    return Comparison(target, source, tuple(reason["code"] for reason in reasons), sentence)


def next_best_sentence(pairs: Sequence[Document]) -> str:
    """The second pose of the decisive pair, else the best of the next pair; empty if there is neither."""
    if not pairs:
        return ""
    decisive = pairs[0]
    if len(decisive["assessments"]) > 1:
        first, second = decisive["assessments"][:2]
        return (
            f"another pose of {decisive['source']} against {decisive['target']}, with evidence "
            f"{second['evidence']:.0f} against {first['evidence']:.0f} ({second['agree']} points agree, "
            f"{second['violate']} stand in empty space)."
        )
    return decisive_comparison(pairs[1]).sentence if len(pairs) > 1 else ""
