# SPDX-License-Identifier: Apache-2.0
"""What is doubtful in a run although it did not stop it."""

from __future__ import annotations

from collections.abc import Iterator

from multilica.explanation.comparisons import Document

__all__ = ["warnings_of"]

_OUTLIER_WEIGHT = 0.5


def warnings_of(document: Document) -> tuple[str, ...]:
    """A sentence each: sensors that are not well, placements far from their prior, pairs that contradict the others."""
    return (*_sensors(document), *_priors(document), *_outliers(document))


def _sensors(document: Document) -> Iterator[str]:
    for name, entry in document["lidars"].items():
        for reason in (entry.get("health") or {}).get("reasons", ()):
            if reason["code"] == "dirty":
                yield f"{name} has a dirty or covered window: {reason['text']}."


def _priors(document: Document) -> Iterator[str]:
    for entry in document["lidars"].values():
        surprise = (entry.get("prior") or {}).get("surprise")
        if surprise:
            yield surprise


def _outliers(document: Document) -> Iterator[str]:
    for edge in (document.get("refinement") or {}).get("pairs", ()):
        if edge["weight"] < _OUTLIER_WEIGHT:
            yield (
                f"the pair {edge['source']} against {edge['target']} contradicts the others by "
                f"{edge['after_m']:.3f} m, {edge['after_deg']:.2f} deg; one of its LiDARs may be misplaced."
            )
