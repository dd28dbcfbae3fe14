# SPDX-License-Identifier: Apache-2.0
"""Log lines of events."""

import statistics
from typing import Literal, NamedTuple

from multilica import events, results
from multilica.errors import MultilicaError
from multilica.results.building import surprises

LogLevel = Literal["DEBUG", "INFO", "WARN", "ERROR"]


class LogLine(NamedTuple):
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


def log_lines(event: events.Event) -> tuple[LogLine, ...]:  # noqa: C901, PLR0911, PLR0912 - one case per event type
    """Return the log lines of an event."""
    match event:
        case events.CalibrationStarted():
            return _started(event)
        case events.StageStarted(stage):
            return _line(f"stage {stage} started", "DEBUG")
        case events.StageFinished(stage):
            return _line(f"stage {stage} finished")
        case events.CloudPreprocessed(cloud):
            return _preprocessed(cloud)
        case events.FeaturesComputed(features):
            return _line(f"{features.lidar}: {len(features.points_m):,} descriptors")
        case events.CorrespondencesMatched(matches):
            text = f"{pair_label(matches.target, matches.source)}: {len(matches):,} matches"
            return _line(text, "INFO" if len(matches) else "WARN")
        case events.HypothesesFound(coarse, matches):
            return _hypotheses(coarse, len(matches))
        case events.HypothesesVerified():
            return _verified(event)
        case events.SearchWidened():
            labels, size = ", ".join(pair_label(*pair) for pair in event.pairs), f"{event.voxel_size_m:g} m"
            return _line(f"no accepted pair connects these yet: searching again with voxels of {size}: {labels}")
        case events.PairRegistered(found):
            return _registered(found, found.start_name)
        case events.GroupsRegistered(found):
            return _registered(found, "the merged pose")
        case events.LoopRegistered(found):
            return _registered(found, f"the pose {found.start_name}")
        case events.VerdictChanged(found):
            return _line(f"{pair_label(found.target, found.source)}: {_verdict(found)}", "WARN")
        case events.TargetChosen(target, reason):
            return _line(f"target: {target} ({reason})")
        case events.MergeStepTaken(decision):
            return _merge_step(decision)
        case events.MovableFound(lidar, points_m, count, moved):
            left_out = "moved, left out" if moved else "could have moved"
            share = f"{lidar}: {len(points_m):,} of {count:,} points on objects that {left_out}"
            return _line(share, "INFO" if moved else "DEBUG")
        case events.RigRefined(refinement):
            return _refined(refinement)
        case events.StopsLinked(stops, links):
            used = sum(link.used for link in links)
            return _line(f"{len(stops)} stops linked by {used} of {len(links)} registrations between them")
        case events.SurfacesMatched(matches):
            pair = pair_label(matches.target, matches.source)
            return _line(f"{pair}: {len(matches):,} points on surfaces of both at the final pose", "DEBUG")
        case events.ResidualsMeasured(residuals):
            return _residuals(residuals)
        case events.GroundEstimated(None, reason):
            return _line(f"no ground plane: {reason}", "WARN")
        case events.GroundEstimated(results.GroundPlane(offset_m=offset_m), reason):
            return _line(f"the target is {offset_m:.3f} m above ground: {reason}")
        case events.CalibrationFinished(result):
            return _finished(result)
        case _:
            raise TypeError(f"{type(event).__name__} has no log line")


def _line(text: str, level: LogLevel = "INFO") -> tuple[LogLine, ...]:
    return (LogLine(level, text),)


def _started(event: events.CalibrationStarted) -> tuple[LogLine, ...]:
    snapshot = event.snapshot
    found = ", ".join(
        f"{lidar.name} with {lidar.points_count:,} points in {len(lidar.scans)} frame(s)" for lidar in snapshot.lidars
    )
    lines = _line(f"calibrating {len(snapshot.lidars)} LiDARs of {snapshot.source or 'memory'}: {found}")
    known = () if event.prior is None else [name for name in snapshot.names if name in event.prior.members]
    lines += _line(f"the prior has {', '.join(known)}") if known else ()
    return lines + tuple(LogLine("WARN", note) for note in snapshot.notes)


def _preprocessed(cloud: results.PreprocessedCloud) -> tuple[LogLine, ...]:
    dropped = ", ".join(f"{len(points):,} {reason}" for reason, points in sorted(cloud.dropped_m.items()))
    text = f"{cloud.lidar}: {len(cloud.points_m):,} points after cleaning and thinning; dropped: {dropped or 'none'}"
    doubts = cloud.health.reasons if cloud.health is not None else ()
    return (
        *_line(text, "INFO" if len(cloud.points_m) else "ERROR"),
        *(LogLine("WARN", f"{cloud.lidar}: {doubt.text}") for doubt in doubts),
    )


def _hypotheses(coarse: results.CoarseResult, total: int) -> tuple[LogLine, ...]:
    label = pair_label(coarse.target, coarse.source)
    prior = [one for one in coarse.hypotheses if one.origin == results.PRIOR]
    with_prior = "".join(f"; {one.score:g} agree with the prior" for one in prior)
    found = len(coarse.hypotheses) - len(prior)
    if not found:
        return _line(f"{label}: no hypothesis from {total:,} matches{with_prior}", "WARN")
    best = coarse.hypotheses[0]
    return _line(f"{label}: {found} hypotheses, {best.score:g} of {total:,} matches agree with the best{with_prior}")


def _verified(event: events.HypothesesVerified) -> tuple[LogLine, ...]:
    label = pair_label(event.target, event.source)
    if not event.registrations:
        return _line(f"{label}: no hypothesis to score", "WARN")
    best = event.registrations[0]
    beams = best.visibility
    return _line(
        f"{label}: {len(event.registrations)} distinct poses, {best.name} has the most evidence: "
        f"{best.evidence:z.1f}; {beams.agree:,} points agree, {beams.violate:,} lie in proven-empty space, "
        f"{beams.occluded:,} are occluded"
    )


def _registered(found: results.PairRegistration, start: str) -> tuple[LogLine, ...]:
    fit = f"fitness {found.fitness:.3f}, RMSE {found.rmse_m:.3f} m" if found.inliers else "no points in common"
    known = "" if found.iterations is None else f" after {found.iterations} iterations"
    text = f"{pair_label(found.target, found.source)} from {start}: {fit}{known}"
    return _line(f"{text}; {_verdict(found)}", "INFO" if found.verdict.accepted else "WARN")


def _verdict(found: results.PairRegistration) -> str:
    verdict = found.verdict
    return f"{verdict.outcome}: {verdict.text}" if verdict.reasons else verdict.outcome


def _merge_step(decision: results.MergeDecision) -> tuple[LogLine, ...]:
    groups = "; ".join(" + ".join(group) for group in decision.groups)
    level: LogLevel = "WARN" if decision.chosen is None and len(decision.groups) > 1 else "INFO"
    return _line(f"merge step {decision.step + 1}: {decision.reason}; groups: {groups}", level)


def _refined(refinement: results.Refinement) -> tuple[LogLine, ...]:
    if not refinement.pairs:
        return _line("nothing to refine: no accepted pair with a known uncertainty connects to the target")
    before, after = refinement.cycle_error_before, refinement.cycle_error_after
    outliers = [pair for pair in refinement.pairs if pair.contradicts]
    return (
        *_line(
            f"refined over {len(refinement.pairs)} pairs: largest disagreement {before.m * 1e3:.1f} mm, "
            f"{before.deg:.3f} deg before, {after.m * 1e3:.1f} mm, {after.deg:.3f} deg after"
        ),
        *(
            LogLine("WARN", f"{pair_label(pair.target, pair.source)} does not fit the others: {pair.apart_m:.3f} m off")
            for pair in outliers
        ),
    )


def _residuals(residuals: results.SurfaceResiduals) -> tuple[LogLine, ...]:
    count, name = len(residuals.residual_m), residuals.lidar
    if count == 0:
        return _line(f"{name}: no points on surfaces of the LiDARs that its accepted pairs link to it", "WARN")
    median_mm = 1e3 * statistics.median(residuals.residual_m.tolist())
    return _line(f"{name}: {count:,} points on surfaces of other LiDARs, {median_mm:.0f} mm off (median)")


def _finished(result: results.CalibrationResult) -> tuple[LogLine, ...]:
    if result.refusal is not None:
        return _line(f"refused: {result.refusal.text}", "ERROR")
    missing = [place for place in result.placements if place.status == "not_placed"]
    uncertain = [place for place in result.placements if place.uncertain]
    count = len(result.placements)
    placed = f"{count - len(missing) - len(uncertain)} of {count} LiDARs placed"
    placed += f", {len(uncertain)} uncertain" if uncertain else ""
    doubtful = [
        report
        for report in result.snapshots
        if report.outliers or report.disputed or report.contradicting or report.refusal
    ]
    return (
        *(
            LogLine("WARN" if report in doubtful else "INFO", f"snapshot {report.name}: {report.text}")
            for report in result.snapshots
        ),
        *(LogLine("WARN", knock.text) for knock in result.knocks),
        *(LogLine("ERROR", f"{place.lidar} is not placed: {place.reason}") for place in missing),
        *(LogLine("WARN", f"{place.lidar} is uncertain: {place.reason}") for place in uncertain),
        *(LogLine("WARN", text) for text in surprises(result)),
        *_line(f"calibration {result.status}: {placed}", "WARN" if missing or uncertain else "INFO"),
    )
