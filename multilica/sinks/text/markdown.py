# SPDX-License-Identifier: Apache-2.0
"""Tables and the summary of a run as markdown."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from multilica.diagnosis import Explanation, Missing, Uncertain, explain
from multilica.results import (
    PRIOR,
    CalibrationResult,
    Hypothesis,
    LidarPlacement,
    MergeCandidate,
    MergeDecision,
    PairKey,
    PairRegistration,
    Registration,
)
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.shapes import SIGMAS, ellipsoid_scale
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table; cells may hold any text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(escaped(cell) for cell in line)} |" for line in lines)


def thousandths(value: float) -> str:
    """Format with three decimals; a dash if not finite, as the RMSE without points in common."""
    return f"{value:.3f}" if math.isfinite(value) else "-"


def escaped(text: str) -> str:
    """Escape what would end a cell."""
    return text.replace("|", "\\|").replace("\n", " ")


Shown = Registration | Hypothesis

_SHOWN_HYPOTHESES = 3
_FIGURES_HEADER = (
    "pair",
    "matches",
    "graph nodes",
    "graph edges",
    "fitness",
    "coverage",
    "violate",
    "verdict",
    "reasons",
)
_RMSE_NOTE = (
    "RMSE: distance of neighbouring points of the two clouds, so it contains their spacing and roughness. The error of "
    "a pose is far smaller, and sigma estimates it."
)
_FIGURES_NOTE = (
    "Fitness: share of source points near the target's cloud. Coverage: share of agreeing points among those in the "
    "other LiDAR's view. Matrices have the target in rows, the source in columns."
)
_SCORES_HEADER = ("pose", "step", "matches", "GICP", "agree", "violate", "occluded", "evidence", "fitness", "RMSE m")
_SCORES_LEGEND = (
    "Points of both LiDARs by what the other one's beams prove: green lie on a measured surface, red in proven-empty "
    "space, grey behind a surface, dark out of view. Evidence: log-odds that the pose is the true one. To see a pose, "
    "go to its step on the timeline `step`."
)


def pair_figures_markdown(state: RunState) -> str:
    """Tabulate the figures of every pair."""
    table = markdown_table(_FIGURES_HEADER, [_figures_row(state, pair) for pair in state.pairs])
    return f"{table}\n\n{_FIGURES_NOTE}"


def _figures_row(state: RunState, pair: PairKey) -> Sequence[str]:
    coarse, found = state.coarse.get(pair), state.registrations.get(pair)
    nodes, edges = (coarse.graph_nodes, coarse.graph_edges) if coarse is not None else (0, 0)
    counts = (pair_label(*pair), f"{len(state.matches.get(pair, ())):,}", f"{nodes:,}", f"{edges:,}")
    if found is None:
        return (*counts, "-", "-", "-", "no pose", "-")
    reasons = ", ".join(reason.code.replace("_", " ") for reason in found.verdict.reasons) or "-"
    violate = f"{found.registrations[0].visibility.violation_share:.1%}" if found.registrations else "-"
    return (*counts, f"{found.fitness:.3f}", f"{found.coverage:.3f}", violate, found.verdict.outcome, reasons)


def pair_scores_markdown(state: RunState, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]) -> str:
    """Describe the verdict and the search; add a row per pose, the one with the most evidence first.

    Args:
        shown: the pose that the view shows at this step; its row is bold.
        shown_at: the step at which each pose is shown.
    """
    found, coarse = state.registrations.get(pair), state.coarse.get(pair)
    parts = [f"# {pair_label(*pair)}"]
    if found is not None:
        parts.append("\n- ".join([f"**{found.verdict.outcome}**", *(reason.text for reason in found.verdict.reasons)]))
    if coarse is not None:
        graph = f"consistency graph: {coarse.graph_nodes:,} nodes, {coarse.graph_edges:,} edges; "
        matches = f"{len(state.matches.get(pair, ())):,} matches; {graph if coarse.graph_nodes else ''}"
        parts.append(f"{matches}hypotheses: {len(coarse.hypotheses)}")
    rows = _score_rows(state, pair, shown, shown_at)
    parts += [markdown_table(_SCORES_HEADER, rows)] if rows else []
    return "\n\n".join([*parts, _SCORES_LEGEND])


def _score_rows(
    state: RunState, pair: PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]
) -> list[tuple[str, ...]]:
    """Return the poses after full GICP, those after a short one, each by evidence, then the others."""
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    full = state.registrations[pair].registrations if pair in state.registrations else ()
    known = {one.hypothesis for one in full}
    short = [one for one in state.verified.get(pair, ()) if one.hypothesis not in known]
    known |= {one.hypothesis for one in short}
    rows: list[tuple[Shown, tuple[str, ...]]] = [
        (one, (_matches(one, hypotheses), how, *_scores(one)))
        for how, scored in (("full", full), ("short", short))
        for one in scored
    ]
    rows += [(one, (f"{one.score:g}", *("-",) * 7)) for index, one in enumerate(hypotheses) if index not in known]
    lines = []
    for one, figures in rows:
        line = (one.name, str(shown_at.get(one, "-")), *figures)
        lines.append(tuple(f"**{cell}**" for cell in line) if one is shown else line)
    return lines


def _matches(one: Registration, hypotheses: Sequence[Hypothesis]) -> str:
    """Return how many matches agree with the hypothesis; "-" for a pose that does not come from matches."""
    index = one.hypothesis
    return f"{hypotheses[index].score:g}" if 0 <= index < len(hypotheses) and not one.derivation else "-"


def _scores(one: Registration) -> Sequence[str]:
    beams = one.visibility
    counts = (f"{beams.agree:,}", f"{beams.violate:,}", f"{beams.occluded:,}", f"{one.evidence:z.1f}")
    return (*counts, thousandths(one.fitness), thousandths(one.rmse_m))


def hypotheses_markdown(state: RunState) -> str:
    """Tabulate the best poses of every pair, and that of the prior."""
    header = ("pair", "pose", "matches", "agree", "violate", "evidence", "fitness", "RMSE m", "verdict")
    rows = [row for pair in state.pairs for row in _hypothesis_rows(state, pair)]
    legend = (
        "The best of each pair first. Evidence: log-odds that the pose is the true one. Scored points: green agree "
        "with a surface that the other LiDAR measured, red lie in space that its beams proved empty, grey are occluded."
    )
    return f"# Hypotheses\n\n{legend} {_RMSE_NOTE}\n\n{markdown_table(header, rows)}"


def _hypothesis_rows(state: RunState, pair: PairKey) -> Iterable[Sequence[str]]:
    label = pair_label(*pair)
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    found, verified = state.registrations.get(pair), state.verified.get(pair, ())
    scored = verified or (() if found is None else found.registrations)
    prior = [one for one in scored if one.origin == PRIOR]
    for one in dict.fromkeys([*scored[:_SHOWN_HYPOTHESES], *prior]):
        beams = (f"{one.visibility.agree:,}", f"{one.visibility.violate:,}", f"{one.evidence:z.1f}")
        registered = found is not None and found.start_name == one.name
        yield (label, one.name, _matches(one, hypotheses), *beams, *(_fit(found) if registered else ("-",) * 3))
    if scored:
        return
    for guess in hypotheses[:_SHOWN_HYPOTHESES]:
        registered = found is not None and found.hypothesis == guess.index
        yield (label, guess.name, f"{guess.score:g}", *("-",) * 3, *(_fit(found) if registered else ("-",) * 3))
    if not hypotheses:
        yield (label, "none", f"0 of {len(state.matches.get(pair, ()))}", *("-",) * 6)


def _fit(found: PairRegistration | None) -> Sequence[str]:
    return () if found is None else (thousandths(found.fitness), thousandths(found.rmse_m), found.verdict.outcome)


def decisions_markdown(decisions: Sequence[MergeDecision], *, by_evidence: bool) -> str:
    """Tabulate the merge steps, the latest first.

    Args:
        by_evidence: whether evidence ranks the candidates; without verification, fitness does.
    """
    return "\n\n".join([*(_decision_part(decision, by_evidence) for decision in reversed(decisions)), _RMSE_NOTE])


def _decision_part(decision: MergeDecision, by_evidence: bool) -> str:
    header = ("pair", "rank", "evidence", "fitness", "RMSE m", "verdict")
    rows = [
        (
            candidate_label(one),
            f"{rank}",
            f"{one.evidence:z.1f}" if by_evidence else "-",
            thousandths(one.fitness),
            thousandths(one.rmse_m),
            _candidate_verdict(one, decision.chosen),
        )
        for rank, one in enumerate(decision.candidates, start=1)
    ]
    groups = ". ".join(" + ".join(group) for group in decision.groups)
    ranked = f"Ranked by {'evidence' if by_evidence else 'fitness'}."
    refused = "\n".join(f"- {candidate_label(one)}: {one.reason}" for one in decision.candidates if one.reason)
    table = f"{ranked}\n\n{markdown_table(header, rows)}" if rows else ""
    parts = (f"# Merge step {decision.step + 1}", decision.reason, table, refused, f"Groups after this step: {groups}")
    return "\n\n".join(part for part in parts if part)


def candidate_label(one: MergeCandidate) -> str:
    """Return the name of a pair, or of two groups by their roots."""
    label = pair_label(one.target, one.source)
    return f"{label} (groups)" if one.of_groups else label


def _candidate_verdict(one: MergeCandidate, chosen: MergeCandidate | None) -> str:
    if one == chosen:
        return "merged, uncertain" if one.uncertain else "merged"
    return "passes" if one.passes else "uncertain" if one.uncertain else "does not pass"


# As narrow as it can be: the viewer cuts what is wider than its pane.
_PLACEMENT_HEADER = ("LiDAR", "x m", "y m", "z m", "roll °", "pitch °", "yaw °", "sigma mm", "sigma °")


def summary_markdown(state: RunState, document: ResultDocument | None, ended_by: str = "") -> str:
    """Summarise the outcome, or the progress of a run that has none yet.

    Args:
        document: of that state, see `run_document`.
        ended_by: why the run ended early.
    """
    parts = [
        *([] if document is None else _explanation_parts(explain(document))),
        f"The run ended early: **{escaped(ended_by)}**" if ended_by else "",
        *_result_parts(state.result),
        _input_part(state),
        _version_part(state),
    ]
    return "\n\n".join(part for part in parts if part)


def _explanation_parts(explanation: Explanation) -> Iterator[str]:
    yield f"# {explanation.headline}"
    if explanation.warnings:
        yield "\n".join(f"- **Warning**: {warning}" for warning in explanation.warnings)
    if explanation.known:
        yield "\n".join(f"- {known}" for known in explanation.known)
    for missing in explanation.missing:
        yield _missing_part(missing)
    for uncertain in explanation.uncertain:
        yield _uncertain_part(uncertain)
    if explanation.advice:
        yield "\n".join(f"- What helps: {advice}." for advice in explanation.advice)


def _missing_part(missing: Missing) -> str:
    lines = [f"- **{missing.headline}**", f"  - At stage {missing.step}."]
    if missing.decisive is not None:
        lines.append(f"  - Decisive: {missing.decisive.sentence}")
    if missing.next_best:
        lines.append(f"  - Next best: {missing.next_best}")
    if missing.by_snapshot:
        lines.append(f"  - By snapshot: {missing.by_snapshot}")
    return "\n".join([*lines, *_advice_lines(missing.advice)])


def _uncertain_part(uncertain: Uncertain) -> str:
    return "\n".join([f"- **{uncertain.headline}**", *_advice_lines(uncertain.advice)])


def _advice_lines(advice: Sequence[str]) -> Iterator[str]:
    return (f"  - What helps: {each}." for each in advice)


def _result_parts(result: CalibrationResult | None) -> Iterator[str]:
    if result is None or result.refusal is not None:
        return
    if any(place.T_target_source is not None and place.lidar != result.target for place in result.placements):
        yield f"Target: **{escaped(result.target)}** ({escaped(result.target_reason)})"
    yield markdown_table(_PLACEMENT_HEADER, [_placement_row(place) for place in result.placements])
    if any(place.covariance is not None for place in result.placements):
        scale = ellipsoid_scale(result.placements)
        yield f"Ellipsoids of the rig: {SIGMAS:g} sigma of the position, {scale:g} times enlarged."
    if result.snapshots:
        yield "\n".join(f"- snapshot **{escaped(each.name)}**: {escaped(each.text)}" for each in result.snapshots)
    if result.ground is not None:
        yield f"Ground, frame {escaped(result.ground.frame)}: {escaped(result.ground.text)}."


def _placement_row(place: LidarPlacement) -> Sequence[str]:
    if place.T_target_source is None:
        return (f"{place.lidar} (**not placed**)", *("-",) * 8)
    pose = place.T_target_source
    numbers = (*(f"{value:z.3f}" for value in pose.xyz_m), *(f"{value:z.2f}" for value in pose.rpy_deg))
    xyz_m, rotation_deg = place.sigma_xyz_m, place.sigma_rotation_deg
    sigmas = ("-", "-")
    if xyz_m is not None and rotation_deg is not None:
        sigmas = (f"{1e3 * xyz_m.max():.1f}", f"{rotation_deg.max():.3f}")
    name = f"{place.lidar} (**uncertain**)" if place.uncertain else place.lidar
    return (name, *numbers, *sigmas)


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
