# SPDX-License-Identifier: Apache-2.0
"""How far a run came that has placed nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from multilica.explanation.comparisons import Document

__all__ = ["known_so_far", "progress_sentence"]


def progress_sentence(document: Document) -> str:
    """Where the run ended."""
    progress = document["progress"]
    after = f"after stage {progress['finished'][-1]}" if progress["finished"] else "before any stage had ended"
    during = f", in stage {progress['running']}" if progress["running"] else ""
    return f"The run was cut off {after}{during}; no LiDAR is placed yet."


def known_so_far(document: Document) -> tuple[str, ...]:
    """A sentence per pair, from the last stage that spoke of it; before there are pairs, one per LiDAR."""
    stages = document.get("stages", {})
    for stage, tell in (("fine", _fine), ("verify", _verify), ("coarse", _coarse), ("correspond", _matches)):
        if stage in stages:
            return (*(tell(pair, figures) for pair, figures in stages[stage].items()), *_merged(stages))
    return tuple(
        f"{name}: {figures['points']:,} points after preprocessing."
        for name, figures in stages.get("preprocess", {}).items()
    )


def _fine(pair: str, figures: Mapping[str, Any]) -> str:
    return f"{pair}: {figures['verdict']}, fitness {figures['fitness']:.2f}."


def _verify(pair: str, figures: Mapping[str, Any]) -> str:
    if not figures["distinct"]:
        return f"{pair}: no pose to judge."
    return (
        f"{pair}: {figures['distinct']} distinct poses, the best with {figures['agree']} points that agree and "
        f"{figures['violate']} in empty space."
    )


def _coarse(pair: str, figures: Mapping[str, Any]) -> str:
    return f"{pair}: {figures['hypotheses']} hypotheses."


def _matches(pair: str, figures: Mapping[str, Any]) -> str:
    return f"{pair}: {figures['matches']} matches."


def _merged(stages: Mapping[str, Any]) -> Iterator[str]:
    for step, figures in stages.get("merge", {}).items():
        yield f"merge {step}: {figures['chosen'] or 'nothing'} merged; groups {figures['groups']}."
