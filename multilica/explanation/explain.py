# SPDX-License-Identifier: Apache-2.0
"""From the document of a run to its explanation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from multilica.explanation.causes import ADVICE, PRIOR_ADVICE, WORDS, cause_of_codes, step_of
from multilica.explanation.comparisons import (
    Document,
    comparisons_of,
    decisive_comparison,
    group_of,
    next_best_sentence,
    weighed_in_merge,
)
from multilica.explanation.doubts import warnings_of
from multilica.explanation.explanation import Cause, Comparison, Explanation, Missing, Placed
from multilica.explanation.progress import known_so_far, progress_sentence
from multilica.explanation.two_places import two_places

__all__ = ["explain"]

_BEFORE_PLACES = ("ingest", "preprocess", "features", "correspond", "coarse", "verify", "fine")
_REFUSALS: dict[str, Cause] = {"moving_vehicle": "moving_vehicle"}


def explain(document: Document) -> Explanation:
    """Tell a run: what was placed and how sure, what was not, why, and what would help.

    Args:
        document: what `result.json` holds, or the entity `/result` of a recording; see `multilica.sinks.run_document`.
            Keys that runs of earlier versions lack may be missing.

    Raises:
        KeyError, TypeError: the document is not a whole one.
    """
    if document.get("refusal"):
        return _refused(document)
    if document["status"] == "unfinished":
        return _without_places(document, progress_sentence(document), "unfinished")
    until = document["config"].get("until", "ground")
    if until in _BEFORE_PLACES:
        return _without_places(
            document, f"The run stopped after stage {until}, as asked; no LiDAR is placed yet.", "stopped_early"
        )
    target = document["target"]
    entries = document["lidars"].items()
    missing = tuple(_missing(document, name) for name, entry in entries if not entry["placed"])
    return Explanation(
        headline=_headline(document, missing),
        input=_input(document),
        placed=tuple(_placed(name, entry, target) for name, entry in entries if entry["placed"] and name != target),
        missing=missing,
        warnings=warnings_of(document),
    )


def _refused(document: Document) -> Explanation:
    refusal = document["refusal"]
    cause = _REFUSALS.get(refusal["code"], "unfit_input")
    return Explanation(
        headline=f"Nothing was calibrated: {WORDS[cause]}.",
        input=_input(document),
        cause=cause,
        known=(refusal["text"],),
        advice=ADVICE[cause],
        warnings=warnings_of(document),
    )


def _without_places(document: Document, headline: str, cause: Cause) -> Explanation:
    return Explanation(
        headline=headline,
        input=_input(document),
        cause=cause,
        known=known_so_far(document),
        advice=ADVICE[cause],
        warnings=warnings_of(document),
    )


def _headline(document: Document, missing: Sequence[Missing]) -> str:
    count = len(document["lidars"])
    if not missing:
        return f"All {count} LiDARs are placed; the target is {document['target']}."
    causes = dict.fromkeys(one.cause for one in missing)
    told = [f"{_listed(one.lidar for one in missing if one.cause == cause)}: {WORDS[cause]}" for cause in causes]
    return f"{len(missing)} of {count} LiDARs {'is' if len(missing) == 1 else 'are'} not placed. {'; '.join(told)}."


def _listed(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _input(document: Document) -> str:
    given = document["input"]
    counts = ", ".join(
        f"{name} {entry['points']:,} points in {entry['frames']} frame{'s' * (entry['frames'] != 1)}"
        for name, entry in given["lidars"].items()
    )
    return f"Input: {given['source'] or 'in memory'} ({counts})."


def _placed(name: str, entry: Document, target: str) -> Placed:
    sigma_m, sigma_deg = _largest(entry.get("sigma_xyz_m")), _largest(entry.get("sigma_rotation_deg"))
    if sigma_m is None or sigma_deg is None:
        return Placed(name, sigma_m, sigma_deg, f"{name} is placed relative to {target}; how sure is not known.")
    sure = f"sigma {1e3 * sigma_m:.1f} mm, {sigma_deg:.3f} deg"
    return Placed(name, sigma_m, sigma_deg, f"{name} is placed relative to {target}: {sure}.")


def _largest(values: Iterable[float] | None) -> float | None:
    return None if values is None else max(values)


def _missing(document: Document, name: str) -> Missing:
    pairs = comparisons_of(document, name)
    decisive = decisive_comparison(pairs[0]) if pairs else None
    if document.get("snapshots"):
        return _missing_jointly(document, name, pairs, decisive)
    if decisive is not None and not decisive.codes:
        return _missing_from_rig(document, name, pairs, decisive)
    if decisive is not None and name not in (decisive.target, decisive.source):
        return _missing_with_another(document, name, pairs, decisive)
    return _told(document, name, _cause(document, name, decisive), decisive, next_best_sentence(pairs))


def _missing_with_another(document: Document, name: str, pairs: Sequence[Document], decisive: Comparison) -> Missing:
    """Merged with a LiDAR of its group, of which the decisive comparison is."""
    other = decisive.source if decisive.source in group_of(document, name) else decisive.target
    sentence = f"{name} fits {other}, which is not placed; {decisive.sentence}"
    cause = _sensor_fault(document, name) or "not_joined"
    return _told(document, name, cause, replace(decisive, sentence=sentence), next_best_sentence(pairs))


def _told(document: Document, name: str, cause: Cause, decisive: Comparison | None, next_best: str) -> Missing:
    had_prior = document["lidars"][name].get("prior") is not None
    advice = tuple(one for one in ADVICE[cause] if not (had_prior and one == PRIOR_ADVICE))
    step = step_of(cause, None if decisive is None else decisive.codes)
    return Missing(name, cause, _not_placed(name, cause), step, decisive, next_best=next_best, advice=advice)


def _missing_from_rig(document: Document, name: str, pairs: Sequence[Document], decisive: Comparison) -> Missing:
    """Accepted by a pair of its own; what the merge made of it decides."""
    weighed = weighed_in_merge(document, name)
    fault, places = _sensor_fault(document, name), two_places(document, name, pairs)
    if places is not None:
        believed, other = decisive_comparison(places.believed), decisive_comparison(places.other)
        told = _told(
            document, name, fault or "two_places", replace(believed, sentence=places.sentence), _sentence(weighed)
        )
        return replace(told, elsewhere=other)
    cause: Cause = "not_joined" if len(group_of(document, name)) > 1 else "not_in_rig" if weighed else "unknown"
    sentence = f"{decisive.sentence.rstrip('.')}; {weighed}." if weighed else decisive.sentence
    return _told(document, name, fault or cause, replace(decisive, sentence=sentence), next_best_sentence(pairs))


def _sentence(clause: str) -> str:
    return f"{clause}." if clause else ""


def _missing_jointly(document: Document, name: str, pairs: Sequence[Document], decisive: Comparison | None) -> Missing:
    """Of several snapshots; the pairs are those of one, so one that was accepted decides nothing."""
    if decisive is not None and decisive.codes:
        return _told(document, name, _cause(document, name, decisive), decisive, next_best_sentence(pairs))
    cause = _sensor_fault(document, name) or _joint_cause(document, fits=decisive is not None)
    by_snapshot = f"{document['lidars'][name]['reason'].rstrip('.')}."
    step = step_of(cause, None)
    return Missing(name, cause, _not_placed(name, cause), step, by_snapshot=by_snapshot, advice=ADVICE[cause])


def _joint_cause(document: Document, *, fits: bool) -> Cause:
    """Why a LiDAR is not placed that no pair of the shown snapshot speaks against."""
    if any(snapshot["disputed"] for snapshot in document["snapshots"]):
        return "disputed"
    return "not_joined" if fits else "unknown"


def _not_placed(name: str, cause: Cause) -> str:
    return f"{name} is not placed: {WORDS[cause]}."


def _cause(document: Document, name: str, decisive: Comparison | None) -> Cause:
    """What is wrong with the sensor comes before what is wrong with its pairs, which may follow from it."""
    fault = _sensor_fault(document, name)
    if fault is not None:
        return fault
    return "no_overlap" if decisive is None else cause_of_codes(decisive.codes)


def _sensor_fault(document: Document, name: str) -> Cause | None:
    health = document["lidars"][name].get("health") or {}
    codes = {reason["code"] for reason in health.get("reasons", ())}
    given = document["input"]["lidars"].get(name, {}).get("points")
    if "dead" in codes or (given == 0 and not document.get("snapshots")):
        return "dead_sensor"
    if "dirty" in codes:
        return "dirty_sensor"
    cleaned = document.get("stages", {}).get("preprocess", {}).get(name, {})
    # Of several snapshots, the one that is shown may lack the LiDAR.
    return "no_returns_in_range" if cleaned.get("points") == 0 and given != 0 else None
