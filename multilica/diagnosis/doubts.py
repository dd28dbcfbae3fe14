# SPDX-License-Identifier: Apache-2.0
"""Warnings about a run that did not stop it."""

from collections.abc import Iterator

from multilica.results.document import ResultDocument

__all__ = ["warnings_of"]

_OUTLIER_WEIGHT = 0.5


def warnings_of(document: ResultDocument) -> Iterator[str]:
    """Yield a sentence per dirty sensor, per placement far from its prior, per pair that contradicts the others."""
    for name, entry in document.lidars.items():
        for reason in entry.health.reasons if entry.health is not None else ():
            if reason.code == "dirty":
                yield f"{name} has a dirty or covered window: {reason.text}."
    for entry in document.lidars.values():
        if entry.prior is not None and entry.prior.surprise:
            yield entry.prior.surprise
    for pair in document.refinement.pairs if document.refinement is not None else ():
        if pair.weight < _OUTLIER_WEIGHT:
            yield (
                f"the pair {pair.source} against {pair.target} contradicts the others by "
                f"{pair.after_m or 0.0:.3f} m, {pair.after_deg or 0.0:.2f} deg; one of the two LiDARs may be misplaced."
            )
