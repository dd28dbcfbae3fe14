# SPDX-License-Identifier: Apache-2.0
"""Log lines of events."""

from dataclasses import dataclass
from functools import singledispatch
from typing import Literal

from multilica import events
from multilica.errors import MultilicaError
from multilica.results import PRIOR, PairRegistration
from multilica.sinks.text.prior_comparison import surprises

__all__ = ["LogLevel", "LogLine", "cause_of_end", "log_end", "log_lines", "pair_label"]

LogLevel = Literal["DEBUG", "INFO", "WARN", "ERROR"]

_OUTLIER_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class LogLine:
    """A sentence of the log, without times, so that equal runs have equal logs."""

    level: LogLevel
    text: str


def pair_label(target: str, source: str) -> str:
    """Return the name of a pair for tables, logs and labels."""
    return f"{target} <- {source}"


def log_end(error: BaseException | None) -> LogLine:
    """Return the last line of a run without a result."""
    return LogLine("ERROR", f"the run ended early: {cause_of_end(error)}")


def cause_of_end(error: BaseException | None) -> str:
    """Describe why a run has no result."""
    if error is None:
        return "no result was reached"
    return str(error) if isinstance(error, MultilicaError) else f"{type(error).__name__}: {error}".rstrip(": ")


@singledispatch
def log_lines(event: events.Event) -> tuple[LogLine, ...]:
    """Return the log lines of an event."""
    del event
    return ()


def _line(text: str, level: LogLevel = "INFO") -> tuple[LogLine, ...]:
    return (LogLine(level, text),)


@log_lines.register
def _(event: events.CalibrationStarted) -> tuple[LogLine, ...]:
    snapshot = event.snapshot
    found = ", ".join(
        f"{lidar.name} with {lidar.points_count:,} points in {len(lidar.scans)} frame(s)" for lidar in snapshot.lidars
    )
    lines = _line(f"calibrating {len(snapshot.lidars)} LiDARs of {snapshot.source or 'memory'}: {found}")
    known = () if event.prior is None else [name for name in snapshot.names if name in event.prior.members]
    lines += _line(f"the prior has {', '.join(known)}") if known else ()
    return lines + tuple(LogLine("WARN", note) for note in snapshot.notes)


@log_lines.register
def _(event: events.StageStarted) -> tuple[LogLine, ...]:
    return _line(f"stage {event.stage} started", "DEBUG")


@log_lines.register
def _(event: events.StageFinished) -> tuple[LogLine, ...]:
    return _line(f"stage {event.stage} finished")


@log_lines.register
def _(event: events.CloudPreprocessed) -> tuple[LogLine, ...]:
    cloud = event.cloud
    dropped = ", ".join(f"{len(points):,} {reason}" for reason, points in sorted(cloud.dropped_m.items()))
    text = f"{cloud.lidar}: {len(cloud.points_m):,} points after cleaning and thinning; dropped: {dropped or 'none'}"
    doubts = cloud.health.reasons if cloud.health is not None else ()
    return (
        *_line(text, "INFO" if len(cloud.points_m) else "ERROR"),
        *(LogLine("WARN", f"{cloud.lidar}: {doubt.text}") for doubt in doubts),
    )


@log_lines.register
def _(event: events.FeaturesComputed) -> tuple[LogLine, ...]:
    return _line(f"{event.features.lidar}: {len(event.features.points_m):,} descriptors")


@log_lines.register
def _(event: events.CorrespondencesMatched) -> tuple[LogLine, ...]:
    matches = event.correspondences
    text = f"{pair_label(matches.target, matches.source)}: {len(matches):,} matches"
    return _line(text, "INFO" if len(matches) else "WARN")


@log_lines.register
def _(event: events.HypothesesFound) -> tuple[LogLine, ...]:
    coarse, total = event.coarse, len(event.correspondences)
    label = pair_label(coarse.target, coarse.source)
    prior = [one for one in coarse.hypotheses if one.origin == PRIOR]
    with_prior = "".join(f"; {one.score:g} agree with the prior" for one in prior)
    found = len(coarse.hypotheses) - len(prior)
    if not found:
        return _line(f"{label}: no hypothesis from {total:,} matches{with_prior}", "WARN")
    best = coarse.hypotheses[0]
    return _line(f"{label}: {found} hypotheses, {best.score:g} of {total:,} matches agree with the best{with_prior}")


@log_lines.register
def _(event: events.HypothesesVerified) -> tuple[LogLine, ...]:
    label = pair_label(event.target, event.source)
    if not event.registrations:
        return _line(f"{label}: no hypothesis to score", "WARN")
    best = event.registrations[0]
    name = "the prior" if best.origin == PRIOR else f"#{best.hypothesis}"
    beams = best.visibility
    return _line(
        f"{label}: {len(event.registrations)} distinct hypotheses, {name} has the most evidence: "
        f"{beams.agree:,} points agree, {beams.violate:,} lie in proven-empty space, {beams.occluded:,} are occluded"
    )


@log_lines.register
def _(event: events.SearchWidened) -> tuple[LogLine, ...]:
    labels = ", ".join(pair_label(*pair) for pair in event.pairs)
    return _line(
        f"no accepted pair connects these yet: searching again with voxels of {event.voxel_size_m:g} m: {labels}"
    )


@log_lines.register
def _(event: events.PairRegistered | events.GroupsRegistered | events.LoopRegistered) -> tuple[LogLine, ...]:
    found = event.registration
    start = "the prior" if found.start_label == PRIOR else f"hypothesis #{found.hypothesis}"
    if isinstance(event, events.GroupsRegistered):
        start = "the merged pose"
    elif isinstance(event, events.LoopRegistered):
        start = "the pose that the rig implies"
    fit = f"fitness {found.fitness:.3f}, RMSE {found.rmse_m:.3f} m" if found.inliers else "no points in common"
    text = f"{pair_label(found.target, found.source)} from {start}: {fit} after {found.iterations} iterations"
    return _line(f"{text}; {_verdict(found)}", "INFO" if found.verdict.accepted else "WARN")


@log_lines.register
def _(event: events.VerdictChanged) -> tuple[LogLine, ...]:
    found = event.registration
    return _line(f"{pair_label(found.target, found.source)}: {_verdict(found)}", "WARN")


def _verdict(found: PairRegistration) -> str:
    verdict = found.verdict
    return f"{verdict.outcome}: {verdict.text}" if verdict.reasons else verdict.outcome


@log_lines.register
def _(event: events.TargetChosen) -> tuple[LogLine, ...]:
    return _line(f"target: {event.target} ({event.reason})")


@log_lines.register
def _(event: events.MergeStepTaken) -> tuple[LogLine, ...]:
    decision = event.decision
    groups = "; ".join(" + ".join(group) for group in decision.groups)
    level: LogLevel = "WARN" if decision.chosen is None and len(decision.groups) > 1 else "INFO"
    return _line(f"merge step {decision.step}: {decision.reason}; groups: {groups}", level)


@log_lines.register
def _(event: events.RigRefined) -> tuple[LogLine, ...]:
    pairs = event.refinement.pairs
    if not pairs:
        return _line("nothing to refine: no accepted pair carries information")
    (before_m, after_m), (before_deg, after_deg) = event.refinement.cycle_error_m, event.refinement.cycle_error_deg
    return (
        *_line(
            f"refined over {len(pairs)} pairs: largest disagreement {before_m * 1e3:.1f} mm, {before_deg:.3f} deg "
            f"before, {after_m * 1e3:.1f} mm, {after_deg:.3f} deg after"
        ),
        *(
            LogLine("WARN", f"{pair_label(pair.target, pair.source)} does not fit the others: {pair.after_m:.3f} m off")
            for pair in pairs
            if pair.weight < _OUTLIER_WEIGHT
        ),
    )


@log_lines.register
def _(event: events.GroundEstimated) -> tuple[LogLine, ...]:
    if event.ground is None:
        return _line(f"no ground plane: {event.reason}", "WARN")
    return _line(f"the target is {event.ground.offset_m:.3f} m above ground: {event.reason}")


@log_lines.register
def _(event: events.CalibrationFinished) -> tuple[LogLine, ...]:
    result = event.result
    if result.refusal is not None:
        return _line(f"refused: {result.refusal.text}", "ERROR")
    missing = [place for place in result.placements if not place.placed]
    placed = f"{len(result.placements) - len(missing)} of {len(result.placements)} LiDARs placed"
    return (
        *(
            LogLine(
                "WARN" if report.outliers or report.disputed or report.refusal else "INFO",
                f"snapshot {report.name}: {report.text}",
            )
            for report in result.snapshots
        ),
        *(LogLine("ERROR", f"{place.lidar} is not placed: {place.reason}") for place in missing),
        *(LogLine("WARN", text) for text in surprises(result)),
        *_line(f"calibration {result.status}: {placed}", "WARN" if missing else "INFO"),
    )
