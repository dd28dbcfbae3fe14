# SPDX-License-Identifier: Apache-2.0
"""What a calibration found, as markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from multilica.explanation import explain
from multilica.results import (
    PRIOR,
    CalibrationResult,
    Hypothesis,
    LidarPlacement,
    MergeDecision,
    PairKey,
)
from multilica.sinks.explanation_markdown import explanation_markdown
from multilica.sinks.markdown import escaped, markdown_table, thousandths
from multilica.sinks.narration import pair_label
from multilica.sinks.run_story import RunStory
from multilica.sinks.uncertainty import SHOWN_ELLIPSOID_SCALE, SIGMAS
from multilica.testimony import Testimony

__all__ = ["decisions_markdown", "hypotheses_markdown", "summary_markdown"]

_SHOWN_HYPOTHESES = 3


def summary_markdown(story: RunStory, document: Mapping[str, Any] | None, ended_by: str = "") -> str:
    """The outcome in one page; while the run goes on, how far it is; or what ended it early.

    Args:
        document: of that story, see `run_document`.
    """
    ending = f"The run ended early: **{escaped(ended_by)}**" if ended_by else ""
    parts = [
        _explanation_part(document),
        ending,
        *_result_parts(story.result),
        _input_part(story),
        _version_part(story),
    ]
    return "\n\n".join(part for part in parts if part)


def _explanation_part(document: Mapping[str, Any] | None) -> str:
    return "" if document is None else explanation_markdown(explain(document))


def _result_parts(result: CalibrationResult | None) -> Iterable[str]:
    if result is None or result.refusal is not None:
        return
    if any(place.placed and place.lidar != result.target for place in result.placements):
        yield f"Target: **{escaped(result.target)}**, {escaped(result.target_reason)}"
    yield markdown_table(
        (
            "LiDAR",
            "x m",
            "y m",
            "z m",
            "roll deg",
            "pitch deg",
            "yaw deg",
            "sigma mm",
            "sigma deg",
            "fitness",
            "RMSE m",
        ),
        [_placement_row(place) for place in result.placements],
    )
    if any(place.covariance is not None for place in result.placements):
        yield f"Ellipsoids of the rig: {SIGMAS:g} sigma of the position, {SHOWN_ELLIPSOID_SCALE:g} times enlarged."
    if result.snapshots:
        yield "\n".join(f"- snapshot **{escaped(each.name)}**: {escaped(each.text)}" for each in result.snapshots)
    if result.ground is not None:
        share = f"{result.ground.inlier_share:.0%} of the points"
        yield f"Ground: {result.ground.offset_m:.3f} m below the target, {share}."


def _placement_row(place: LidarPlacement) -> Sequence[str]:
    if place.T_target_source is None or not place.placed:
        return (place.lidar, *("-",) * 9, "not placed")
    pose = place.T_target_source
    numbers = (*(f"{value:.3f}" for value in pose.xyz_m), *(f"{value:.2f}" for value in pose.rpy_deg))
    return (place.lidar, *numbers, *_sigmas(place), thousandths(place.fitness), thousandths(place.rmse_m))


def _sigmas(place: LidarPlacement) -> Sequence[str]:
    """The largest standard deviations of position and rotation."""
    xyz_m, rotation_deg = place.sigma_xyz_m, place.sigma_rotation_deg
    if xyz_m is None or rotation_deg is None:
        return ("-", "-")
    return (f"{1e3 * xyz_m.max():.1f}", f"{rotation_deg.max():.3f}")


def _input_part(story: RunStory) -> str:
    if story.snapshot is None:
        return ""
    rows = [
        (lidar.name, lidar.topic or "-", str(len(lidar.scans)), f"{lidar.points_count:,}")
        for lidar in story.snapshot.lidars
    ]
    digest = story.snapshot.source_sha256[:16] or "none"
    source = f"## Input\n\n`{story.snapshot.source or 'in memory'}`, sha256 `{digest}`"
    return f"{source}\n\n{markdown_table(('LiDAR', 'topic', 'frames', 'points'), rows)}"


def _version_part(story: RunStory) -> str:
    if story.provenance is None:
        return ""
    return ", ".join(f"{package} {version}" for package, version in story.provenance.versions.items())


def hypotheses_markdown(story: RunStory) -> str:
    """Per pair its best poses with what speaks for each, and that of the prior."""
    header = ("pair", "pose", "matches", "agree", "violate", "evidence", "fitness", "RMSE m", "verdict")
    rows = [row for pair in story.pairs for row in _hypothesis_rows(story, pair)]
    legend = (
        "The best of each pair first. Judged points: green agree with the other sensor's surfaces, "
        "red lie in space that its beams passed through, grey are hidden from it."
    )
    return f"# Hypotheses\n\n{legend}\n\n{markdown_table(header, rows)}"


def _hypothesis_rows(story: RunStory, pair: PairKey) -> Iterable[Sequence[str]]:
    label = pair_label(*pair)
    order = _believed(story, pair)
    if not order:
        yield (label, "none", f"0 of {len(story.matches.get(pair, ()))}", *("-",) * 6)
    claimed = [index for index, one in enumerate(_hypotheses(story, pair)) if one.origin == PRIOR]
    shown = dict.fromkeys([*order[:_SHOWN_HYPOTHESES], *claimed])
    for index in shown:
        yield (label, PRIOR if index in claimed else f"#{index}", *_scores(story, pair, index))


def _hypotheses(story: RunStory, pair: PairKey) -> Sequence[Hypothesis]:
    return story.coarse[pair].hypotheses if pair in story.coarse else ()


def _believed(story: RunStory, pair: PairKey) -> Sequence[int]:
    """Indices of the pair's hypotheses, the best first."""
    if story.assessments.get(pair):
        return [assessment.hypothesis for assessment in story.assessments[pair]]
    return range(len(_hypotheses(story, pair)))


def _scores(story: RunStory, pair: PairKey, index: int) -> Sequence[str]:
    hypotheses = _hypotheses(story, pair)
    matches = f"{hypotheses[index].score:g}" if index < len(hypotheses) else "-"
    judged = next((one for one in story.assessments.get(pair, ()) if one.hypothesis == index), None)
    visibility = _visibility(judged.testimony) if judged else ("-",) * 3
    found = story.registrations.get(pair)
    if found is None or found.hypothesis != index:
        return (matches, *visibility, "-", "-", "-")
    return (matches, *visibility, thousandths(found.fitness), thousandths(found.rmse_m), found.verdict.outcome)


def _visibility(testimony: Testimony) -> Sequence[str]:
    return (f"{testimony.agree:,}", f"{testimony.violate:,}", f"{testimony.evidence:,.0f}")


def decisions_markdown(decisions: Sequence[MergeDecision]) -> str:
    """The merge steps, the latest first: what could have been chosen, what was, and why."""
    return "\n\n".join(_decision_part(decision) for decision in reversed(decisions))


def _decision_part(decision: MergeDecision) -> str:
    rows = [
        (
            pair_label(one.target, one.source),
            thousandths(one.fitness),
            thousandths(one.rmse_m),
            "merged" if one == decision.chosen else "passes" if one.passes else "does not pass",
        )
        for one in decision.candidates
    ]
    groups = "; ".join(" + ".join(group) for group in decision.groups)
    table = markdown_table(("candidate", "fitness", "RMSE m", "verdict"), rows)
    refused = "\n".join(
        f"- {pair_label(one.target, one.source)}: {one.reason}" for one in decision.candidates if one.reason
    )
    parts = (f"# Merge step {decision.step}", decision.reason, table, refused, f"Groups after it: {groups}")
    return "\n\n".join(part for part in parts if part)
