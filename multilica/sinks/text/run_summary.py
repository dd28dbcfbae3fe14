# SPDX-License-Identifier: Apache-2.0
"""The summary of a run as markdown."""

from collections.abc import Iterable, Sequence

from multilica.diagnosis import explain
from multilica.results import PRIOR, CalibrationResult, LidarPlacement, MergeDecision, PairKey
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.ellipsoid import SHOWN_ELLIPSOID_SCALE, SIGMAS
from multilica.sinks.run_state import RunState
from multilica.sinks.text.explanation_markdown import explanation_markdown
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import escaped, markdown_table, thousandths

__all__ = ["decisions_markdown", "hypotheses_markdown", "summary_markdown"]

_SHOWN_HYPOTHESES = 3
_PLACEMENT_HEADER = (
    *("LiDAR", "x m", "y m", "z m", "roll deg", "pitch deg", "yaw deg"),
    *("sigma mm", "sigma deg", "fitness", "RMSE m"),
)


def summary_markdown(state: RunState, document: ResultDocument | None, ended_by: str = "") -> str:
    """Summarise the outcome, or the progress of a run that has none yet.

    Args:
        document: of that state, see `run_document`.
        ended_by: why the run ended early.
    """
    parts = [
        "" if document is None else explanation_markdown(explain(document)),
        f"The run ended early: **{escaped(ended_by)}**" if ended_by else "",
        *_result_parts(state.result),
        _input_part(state),
        _version_part(state),
    ]
    return "\n\n".join(part for part in parts if part)


def _result_parts(result: CalibrationResult | None) -> Iterable[str]:
    if result is None or result.refusal is not None:
        return
    if any(place.placed and place.lidar != result.target for place in result.placements):
        yield f"Target: **{escaped(result.target)}** ({escaped(result.target_reason)})"
    yield markdown_table(_PLACEMENT_HEADER, [_placement_row(place) for place in result.placements])
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
    numbers = (*(f"{value:z.3f}" for value in pose.xyz_m), *(f"{value:z.2f}" for value in pose.rpy_deg))
    xyz_m, rotation_deg = place.sigma_xyz_m, place.sigma_rotation_deg
    sigmas = ("-", "-")
    if xyz_m is not None and rotation_deg is not None:
        sigmas = (f"{1e3 * xyz_m.max():.1f}", f"{rotation_deg.max():.3f}")
    return (place.lidar, *numbers, *sigmas, thousandths(place.fitness), thousandths(place.rmse_m))


def _input_part(state: RunState) -> str:
    if state.snapshot is None:
        return ""
    rows = [
        (lidar.name, lidar.topic or "-", str(len(lidar.scans)), f"{lidar.points_count:,}")
        for lidar in state.snapshot.lidars
    ]
    digest = state.snapshot.source_sha256[:16] or "none"
    source = f"## Input\n\n`{state.snapshot.source or 'in memory'}`, sha256 `{digest}`"
    return f"{source}\n\n{markdown_table(('LiDAR', 'topic', 'frames', 'points'), rows)}"


def _version_part(state: RunState) -> str:
    if state.provenance is None:
        return ""
    return ", ".join(f"{package} {version}" for package, version in state.provenance.versions.items())


def hypotheses_markdown(state: RunState) -> str:
    """Tabulate the best poses of every pair, and that of the prior."""
    header = ("pair", "pose", "matches", "agree", "violate", "evidence", "fitness", "RMSE m", "verdict")
    rows = [row for pair in state.pairs for row in _hypothesis_rows(state, pair)]
    legend = (
        "The best of each pair first. Scored points: green agree with a surface that the other LiDAR measured, red lie "
        "in space that its beams proved empty, grey are occluded."
    )
    return f"# Hypotheses\n\n{legend}\n\n{markdown_table(header, rows)}"


def _hypothesis_rows(state: RunState, pair: PairKey) -> Iterable[Sequence[str]]:
    label = pair_label(*pair)
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    scored = {one.hypothesis: one.visibility for one in state.verified.get(pair, ())}
    order = [*scored] or range(len(hypotheses))
    if not order:
        yield (label, "none", f"0 of {len(state.matches.get(pair, ()))}", *("-",) * 6)
    prior = [index for index, one in enumerate(hypotheses) if one.origin == PRIOR]
    found = state.registrations.get(pair)
    for index in dict.fromkeys([*order[:_SHOWN_HYPOTHESES], *prior]):
        matches = f"{hypotheses[index].score:g}" if index < len(hypotheses) else "-"
        beams, fit = ("-",) * 3, ("-",) * 3
        if index in scored:
            score = scored[index]
            beams = (f"{score.agree:,}", f"{score.violate:,}", f"{score.evidence:z,.0f}")
        if found is not None and found.hypothesis == index:
            fit = (thousandths(found.fitness), thousandths(found.rmse_m), found.verdict.outcome)
        yield (label, PRIOR if index in prior else f"#{index}", matches, *beams, *fit)


def decisions_markdown(decisions: Sequence[MergeDecision]) -> str:
    """Tabulate the merge steps, the latest first."""
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
    table = markdown_table(("pair", "fitness", "RMSE m", "verdict"), rows)
    refused = "\n".join(
        f"- {pair_label(one.target, one.source)}: {one.reason}" for one in decision.candidates if one.reason
    )
    parts = (f"# Merge step {decision.step}", decision.reason, table, refused, f"Groups after this step: {groups}")
    return "\n\n".join(part for part in parts if part)
