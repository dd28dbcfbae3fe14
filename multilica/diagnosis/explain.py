# SPDX-License-Identifier: Apache-2.0
"""Explanation of a result document."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from multilica.config import STAGES
from multilica.diagnosis.by_stop import explained_by_stop
from multilica.diagnosis.doubts import warnings_of
from multilica.diagnosis.explanation import (
    CAUSES,
    PRIOR_ADVICE,
    REASON_WORDS,
    DecisivePair,
    Explanation,
    Missing,
    Placed,
    Uncertain,
    by_weight,
    cause_of_codes,
    in_words,
    step_of,
)
from multilica.results.document import LidarEntry, PairEntry, ResultDocument
from multilica.results.stages import VerifyFigures
from multilica.results.values import BY_CONTRADICTING, COVERED, ONLY_GROUND, ONLY_MOTION, OPEN_POSE

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


_BEFORE_PLACES = STAGES[: STAGES.index("merge")]


def explain(document: ResultDocument) -> Explanation:
    """Explain a run: which LiDARs are placed, which are uncertain or not placed, why, and what would help."""
    if document.refusal is not None:
        cause = "moving_vehicle" if document.refusal.code == "moving_vehicle" else "unfit_input"
        return _without_places(
            document, f"Nothing was calibrated: {CAUSES[cause][0]}.", cause, (document.refusal.text,)
        )
    if document.status == "unfinished":
        return _without_places(document, _progress(document), "unfinished", _known_so_far(document))
    until, target = document.config.until, document.target
    if until in _BEFORE_PLACES:
        headline = f"The run stopped after stage {until} (--until). No LiDAR is placed yet."
        return _without_places(document, headline, "stopped_early", _known_so_far(document))
    missing = tuple(
        explained_by_stop(document, _missing(document, name))
        for name, entry in document.lidars.items()
        if entry.status == "not_placed"
    )
    uncertain = tuple(
        _uncertain(document, name) for name, entry in document.lidars.items() if entry.status == "uncertain"
    )
    return Explanation(
        headline=_headline(document, missing, uncertain),
        input=_input(document),
        placed=tuple(
            _placed(name, entry, target) for name, entry in document.lidars.items() if entry.placed and name != target
        ),
        missing=missing,
        uncertain=uncertain,
        warnings=tuple(warnings_of(document)),
    )


def _without_places(document: ResultDocument, headline: str, cause: str, known: Iterable[str]) -> Explanation:
    told = Explanation(headline, _input(document), cause=cause, known=tuple(known), advice=CAUSES[cause][1:])
    return replace(told, warnings=tuple(warnings_of(document)))


def _progress(document: ResultDocument) -> str:
    """Return where the run ended."""
    progress = document.progress
    after = f"after stage {progress.finished[-1]}" if progress and progress.finished else "before any stage finished"
    during = f", in stage {progress.running}" if progress and progress.running else ""
    return f"The run was cut off {after}{during}. No LiDAR is placed yet."


def _known_so_far(document: ResultDocument) -> Iterator[str]:
    """Yield the figures of the last stage of pairs and the merge steps; before there are pairs, those per LiDAR."""
    if document.pairs and (document.stages is None or document.stages.fine is None):
        for pair in document.pairs:
            yield f"{pair.target} <- {pair.source}: {pair.verdict.outcome}, fitness {pair.fitness or 0.0:.2f}."
    elif document.stages is not None:
        for stage, tell in _FIGURES.items():
            if (figures := getattr(document.stages, stage)) is not None:
                yield from (f"{name}: {tell(each)}." for name, each in figures.items())
                break
        for step, merged in enumerate((document.stages.merge or {}).values(), start=1):
            groups = merged.groups.replace("; ", ", ")
            yield f"Merge step {step}: merged {merged.chosen or 'nothing'}. Groups: {groups}."


def _verified(figures: VerifyFigures) -> str:
    if not figures.distinct:
        return "no pose"
    best = f"{figures.agree} points agree, {figures.violate} are in empty space"
    return f"{figures.distinct} distinct poses, and at the best {best}"


_FIGURES: Mapping[str, Callable[[Any], str]] = {
    "fine": lambda figures: f"{figures.verdict}, fitness {figures.fitness or 0.0:.2f}",
    "verify": _verified,
    "coarse": lambda figures: f"{figures.hypotheses} hypotheses",
    "correspond": lambda figures: f"{figures.matches} matches",
    "preprocess": lambda figures: f"{figures.points:,} points after preprocessing",
}
"""Text for the figures of a pair or LiDAR by stage; the latest stage that has figures counts."""


def _headline(document: ResultDocument, missing: Sequence[Missing], uncertain: Sequence[Uncertain]) -> str:
    count = len(document.lidars)
    if not missing and not uncertain:
        return f"All {count} LiDARs are placed. The target is {document.target}."
    sentences = []
    for found, status in ((missing, "not placed"), (uncertain, "uncertain")):
        causes = dict.fromkeys(one.cause for one in found)
        verb = "is" if len(found) == 1 else "are"
        sentences += [f"{len(found)} of {count} LiDARs {verb} {status}."] if found else []
        sentences += [
            f"{in_words(one.lidar for one in found if one.cause == cause)}: {CAUSES[cause][0]}." for cause in causes
        ]
    return " ".join(sentences)


def _input(document: ResultDocument) -> str:
    counts = ", ".join(
        f"{name} {entry.points:,} points in {entry.frames} frame{'s' * (entry.frames != 1)}"
        for name, entry in document.input.lidars.items()
    )
    of_one = "one of them: " if len(document.snapshots) > 1 else ""
    return f"Input: {document.input.source or 'in memory'} ({of_one}{counts})."


def _placed(name: str, entry: LidarEntry, target: str) -> Placed:
    if entry.largest_sigmas is None:
        return Placed(name, None, None, f"{name} is placed relative to {target}; no uncertainty available.")
    sigma_m, sigma_deg = entry.largest_sigmas
    sigmas = f"sigma {1e3 * sigma_m:.1f} mm, {sigma_deg:.3f} deg"
    return Placed(name, sigma_m, sigma_deg, f"{name} is placed relative to {target}: {sigmas}.")


def _uncertain(document: ResultDocument, name: str) -> Uncertain:
    """Name the standard deviation of an uncertain LiDAR that is above its limit, with its direction."""
    limits = document.config.acceptance
    (sigma_m, along), (sigma_deg, about) = document.lidars[name].weakest_directions()
    if sigma_m > limits.max_sigma_m:
        direction = f"mostly along {along} of {document.target}"
        sigma, limit = f"{1e3 * sigma_m:.1f} mm", f"{1e3 * limits.max_sigma_m:g} mm"
    else:
        direction = f"mostly about {about} of {document.target}"
        sigma, limit = f"{sigma_deg:.3f} deg", f"{limits.max_sigma_deg:g} deg"
    headline = f"{name} is uncertain: sigma {sigma} {direction}, limit {limit}."
    why, _, covered = document.lidars[name].reason.partition(f"; {COVERED} ")
    cause = "two_places" if covered else "uncertain"
    if why.startswith((ONLY_MOTION, ONLY_GROUND)):
        headline, cause = f"{name} is uncertain: {why.rstrip('.')}.", "by_motion"
    if document.lidars[name].held_by_movable:
        cause = "held_by_movable"
        headline = f"{headline} {why.rstrip('.').capitalize()}."
    if covered:
        headline = f"{headline} {COVERED.capitalize()} {covered}."
    return Uncertain(
        name,
        headline,
        direction,
        sigma_m,
        sigma_deg,
        limits.max_sigma_m,
        limits.max_sigma_deg,
        CAUSES[cause][1:],
        cause,
    )


def _missing(document: ResultDocument, name: str) -> Missing:
    if document.lidars[name].reason.startswith(OPEN_POSE):
        return _missing_open(document, name)
    pairs = crossing_pairs(document, name)
    decisive = decisive_pair(pairs[0]) if pairs else None
    codes = () if decisive is None else decisive.codes
    fault, next_best = _sensor_fault(document, name), next_best_sentence(pairs)
    limit = document.time_limit
    out_of_time = limit is not None and (bool(limit.unlinked_stops) or any(name in pair for pair in limit.not_reached))
    disputed = _is_disputed(document, name)
    if document.snapshots and (disputed or not codes):
        # The pairs are those of one snapshot, so an accepted one decides nothing.
        unplaced = "disputed" if disputed else "unknown" if decisive is None else "not_joined"
        unplaced = "out_of_time" if out_of_time else unplaced
        return _missing_by(document, name, fault or unplaced, None, "")
    if not document.snapshots:
        if out_of_time:
            return _missing_by(document, name, "out_of_time", None, next_best)
        if decisive is not None and not codes:
            return _missing_from_rig(document, name, decisive, fault, next_best)
        if decisive is not None and name not in (decisive.target, decisive.source):
            other = decisive.source if decisive.source in group_of(document, name) else decisive.target
            told = replace(decisive, sentence=f"{name} fits {other}, which is not placed. {decisive.sentence}")
            return _missing_by(document, name, fault or "not_joined", told, next_best)
    # The faults of pairs may follow from that of the sensor.
    cause = fault or ("no_overlap" if decisive is None else cause_of_codes(codes))
    return _missing_by(document, name, cause, decisive, next_best)


def _is_disputed(document: ResultDocument, name: str) -> bool:
    """Return whether snapshots contradict each other on the LiDAR, or on one that connects it to the target."""
    disputed = any(name in snapshot.disputed for snapshot in document.snapshots)
    return disputed or BY_CONTRADICTING in document.lidars[name].reason


def _missing_open(document: ResultDocument, name: str) -> Missing:
    """Explain a LiDAR that was joined to the others, but whose pose nothing holds."""
    own = [pair for pair in document.pairs if name in pair.names and pair.verdict.counts]
    best = max(own, key=lambda pair: pair.evidence, default=None)
    sentence = f"{document.lidars[name].reason.rstrip('.')}."
    decisive = None if best is None else DecisivePair(best.target, best.source, ("not_observable",), sentence)
    step = "refine: the joined pairs do not hold its pose"
    return replace(_missing_by(document, name, "not_observable", decisive, ""), step=step)


def _missing_by(
    document: ResultDocument, name: str, cause: str, decisive: DecisivePair | None, next_best: str
) -> Missing:
    had_prior = document.lidars[name].prior is not None
    advice = tuple(one for one in CAUSES[cause][1:] if not (had_prior and one == PRIOR_ADVICE))
    headline = f"{name} is not placed: {CAUSES[cause][0]}."
    step = step_of(cause, None if decisive is None else decisive.codes)
    # The pairs are those of one snapshot.
    by_snapshot = f"{document.lidars[name].reason.rstrip('.')}." if document.snapshots else ""
    return Missing(name, cause, headline, step, decisive, next_best=next_best, advice=advice, by_snapshot=by_snapshot)


def _missing_from_rig(
    document: ResultDocument, name: str, decisive: DecisivePair, fault: str | None, next_best: str
) -> Missing:
    """Explain a LiDAR with an accepted pair, which the merge refused."""
    refusal, places = merge_refusal(document, name), contested_places(document, name)
    if places is not None:
        return replace(_missing_by(document, name, fault or "two_places", places[0], refusal), elsewhere=places[1])
    cause = "not_joined" if len(group_of(document, name)) > 1 else "not_in_rig" if refusal else "unknown"
    told = replace(decisive, sentence=f"{decisive.sentence} {refusal}".rstrip())
    return _missing_by(document, name, fault or cause, told, next_best)


def _sensor_fault(document: ResultDocument, name: str) -> str | None:
    health, given = document.lidars[name].health, document.input.lidars.get(name)
    codes = {reason.code for reason in health.reasons} if health is not None else set()
    silent = given is not None and given.points == 0
    if "dead" in codes or (silent and not document.snapshots):
        return "dead_sensor"
    if "dirty" in codes:
        return "dirty_sensor"
    cleaned = (document.stages.preprocess or {}).get(name) if document.stages is not None else None
    # The one of several snapshots that is shown may lack the LiDAR.
    return "no_returns_in_range" if cleaned is not None and cleaned.points == 0 and not silent else None
