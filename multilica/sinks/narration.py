# SPDX-License-Identifier: Apache-2.0
"""Each event of a calibration as lines of a log."""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch
from typing import Literal

from multilica import events
from multilica.errors import MultilicaError
from multilica.results import PRIOR, Assessment, PairRegistration
from multilica.sinks.prior_words import surprises

__all__ = ["LogLevel", "LogLine", "cause_of_end", "narrate", "narrate_end", "pair_label"]

LogLevel = Literal["DEBUG", "INFO", "WARN", "ERROR"]

_OUTLIER_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class LogLine:
    """One sentence of the log; never with times, so that equal runs tell equal stories."""

    level: LogLevel
    text: str


def pair_label(target: str, source: str) -> str:
    """How a pair is called wherever people read it."""
    return f"{target} <- {source}"


def narrate_end(error: BaseException | None) -> LogLine:
    """What there is to say of a run that came to no result."""
    return LogLine("ERROR", f"the run ended early: {cause_of_end(error)}")


def cause_of_end(error: BaseException | None) -> str:
    """Why a run came to no result, by what was raised."""
    if error is None:
        return "no result was reached"
    return str(error) if isinstance(error, MultilicaError) else f"{type(error).__name__}: {error}".rstrip(": ")


@singledispatch
def narrate(event: events.Event) -> tuple[LogLine, ...]:
    """What there is to say of an event; nothing if it has no say."""
    del event
    return ()


def _info(text: str) -> tuple[LogLine, ...]:
    return (LogLine("INFO", text),)


@narrate.register
def _(event: events.CalibrationStarted) -> tuple[LogLine, ...]:
    snapshot = event.snapshot
    found = ", ".join(
        f"{lidar.name} with {lidar.points_count:,} points in {len(lidar.scans)} frame(s)" for lidar in snapshot.lidars
    )
    notes = tuple(LogLine("WARN", note) for note in snapshot.notes)
    start = _info(f"calibrating {len(snapshot.lidars)} LiDARs of {snapshot.source or 'memory'}: {found}")
    known = () if event.prior is None else [name for name in snapshot.names if name in event.prior.members]
    prior = _info(f"a prior is tried for {', '.join(known)}") if known else ()
    return (*start, *prior, *notes)


@narrate.register
def _(event: events.StageStarted) -> tuple[LogLine, ...]:
    return (LogLine("DEBUG", f"stage {event.stage} begins"),)


@narrate.register
def _(event: events.StageFinished) -> tuple[LogLine, ...]:
    return _info(f"stage {event.stage} finished")


@narrate.register
def _(event: events.CloudPreprocessed) -> tuple[LogLine, ...]:
    cloud = event.cloud
    dropped = ", ".join(f"{len(points):,} {reason}" for reason, points in sorted(cloud.dropped_m.items()))
    text = f"{cloud.lidar}: {len(cloud.points_m):,} points kept and thinned, dropped {dropped or 'none'}"
    doubts = cloud.health.reasons if cloud.health is not None else ()
    return (
        LogLine("INFO" if len(cloud.points_m) else "ERROR", text),
        *(LogLine("WARN", f"{cloud.lidar}: {doubt.text}") for doubt in doubts),
    )


@narrate.register
def _(event: events.FeaturesComputed) -> tuple[LogLine, ...]:
    return _info(f"{event.features.lidar}: {len(event.features.points_m):,} descriptors")


@narrate.register
def _(event: events.CorrespondencesMatched) -> tuple[LogLine, ...]:
    matches = event.correspondences
    text = f"{pair_label(matches.target, matches.source)}: {len(matches):,} matches"
    return (LogLine("INFO" if len(matches) else "WARN", text),)


@narrate.register
def _(event: events.HypothesesFound) -> tuple[LogLine, ...]:
    coarse, total = event.coarse, len(event.correspondences)
    label = pair_label(coarse.target, coarse.source)
    if not coarse.hypotheses:
        return (LogLine("WARN", f"{label}: the {total:,} matches agree on no pose"),)
    prior = [one for one in coarse.hypotheses if one.origin == PRIOR]
    found = len(coarse.hypotheses) - len(prior)
    said = "".join(f"; with the prior {one.score:g} agree" for one in prior)
    if not found:
        return (LogLine("WARN", f"{label}: the {total:,} matches agree on no pose{said}"),)
    best = coarse.hypotheses[0]
    return _info(f"{label}: {found} hypotheses, {best.score:g} of {total:,} matches agree on the first{said}")


@narrate.register
def _(event: events.HypothesesAssessed) -> tuple[LogLine, ...]:
    label = pair_label(event.target, event.source)
    if not event.assessments:
        return (LogLine("WARN", f"{label}: no hypothesis to judge"),)
    best = event.assessments[0]
    beams = best.testimony
    text = (
        f"{label}: of {len(event.assessments)} distinct hypotheses, {_name_of(best)} is believed most: "
        f"{beams.agree:,} points agree, {beams.violate:,} stand in empty space, {beams.occluded:,} are occluded"
    )
    return _info(text)


@narrate.register
def _(event: events.SearchWidened) -> tuple[LogLine, ...]:
    labels = ", ".join(pair_label(*pair) for pair in event.pairs)
    return _info(f"nothing links these yet, searched again with descriptors on {event.voxel_size_m:g} m: {labels}")


@narrate.register
def _(event: events.PairRegistered) -> tuple[LogLine, ...]:
    found = event.registration
    start = _start_of(found)
    fit = f"fitness {found.fitness:.3f}, RMSE {found.rmse_m:.3f} m" if found.inliers else "no points in common"
    text = f"{pair_label(found.target, found.source)} from {start}: {fit} after {found.iterations} iterations"
    doubts = "; ".join(reason.text for reason in found.verdict.reasons)
    verdict = f"{found.verdict.outcome}: {doubts}" if doubts else found.verdict.outcome
    return (LogLine("INFO" if found.verdict.accepted else "WARN", f"{text}; {verdict}"),)


def _name_of(assessment: Assessment) -> str:
    return "the prior" if assessment.origin == PRIOR else f"#{assessment.hypothesis}"


def _start_of(found: PairRegistration) -> str:
    if found.hypothesis < 0:
        return "the merged pose"
    return "the prior" if found.start_label == PRIOR else f"hypothesis #{found.hypothesis}"


@narrate.register
def _(event: events.TargetChosen) -> tuple[LogLine, ...]:
    return _info(f"target is {event.target}: {event.reason}")


@narrate.register
def _(event: events.MergeStepTaken) -> tuple[LogLine, ...]:
    decision = event.decision
    groups = "; ".join(" + ".join(group) for group in decision.groups)
    level: LogLevel = "WARN" if decision.chosen is None and len(decision.groups) > 1 else "INFO"
    return (LogLine(level, f"merge step {decision.step}: {decision.reason}; groups: {groups}"),)


@narrate.register
def _(event: events.RigRefined) -> tuple[LogLine, ...]:
    if not event.refinement.edges:
        return _info("nothing to refine: no accepted pair carries information")
    (before_m, after_m), (before_deg, after_deg) = event.refinement.cycle_error_m, event.refinement.cycle_error_deg
    lines = _info(
        f"refined over {len(event.refinement.edges)} pairs: largest disagreement {before_m * 1e3:.1f} mm, "
        f"{before_deg:.3f} deg before, {after_m * 1e3:.1f} mm, {after_deg:.3f} deg after"
    )
    outliers = [edge for edge in event.refinement.edges if edge.weight < _OUTLIER_WEIGHT]
    return lines + tuple(
        LogLine("WARN", f"{edge.target} <- {edge.source} does not fit the others: {edge.after_m:.3f} m off")
        for edge in outliers
    )


@narrate.register
def _(event: events.GroundEstimated) -> tuple[LogLine, ...]:
    if event.ground is None:
        return (LogLine("WARN", f"no ground plane: {event.reason}"),)
    return _info(f"the target sits {event.ground.offset_m:.3f} m above ground: {event.reason}")


@narrate.register
def _(event: events.CalibrationFinished) -> tuple[LogLine, ...]:
    result = event.result
    if result.refusal is not None:
        return (LogLine("ERROR", f"refused: {result.refusal.text}"),)
    missing = tuple(
        LogLine("ERROR", f"{place.lidar} is not placed: {place.reason}")
        for place in result.placements
        if not place.placed
    )
    snapshots = tuple(
        LogLine(
            "WARN" if report.outliers or report.disputed or report.refusal else "INFO",
            f"snapshot {report.name}: {report.text}",
        )
        for report in result.snapshots
    )
    placed = len(result.placements) - len(missing)
    level: LogLevel = "WARN" if missing else "INFO"
    return (
        *snapshots,
        *missing,
        *(LogLine("WARN", text) for text in surprises(result)),
        LogLine(level, f"calibration {result.status}: {placed} of {len(result.placements)} LiDARs placed"),
    )
