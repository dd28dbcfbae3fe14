# SPDX-License-Identifier: Apache-2.0
"""Tables and the summary of a run as markdown."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from multilica import results
from multilica.diagnosis import Explanation, explain
from multilica.results.document import LidarEntry, ResultDocument
from multilica.sinks.drawing import SIGMAS, ellipsoid_scale
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label

Shown = results.Registration | results.Hypothesis
_SHOWN_HYPOTHESES = 3
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
# As narrow as it can be: the viewer cuts what is wider than its pane.
_PLACEMENT_HEADER = ("LiDAR", "x m", "y m", "z m", "roll °", "pitch °", "yaw °", "sigma mm", "sigma °")


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


def pair_figures_markdown(state: RunState) -> str:
    """Tabulate the figures of every pair."""
    header = ("pair", "matches", "graph nodes", "graph edges", "fitness", "coverage", "violate", "verdict", "reasons")
    table = markdown_table(header, [_figures_row(state, pair) for pair in state.pairs])
    return f"{table}\n\n{_FIGURES_NOTE}"


def _figures_row(state: RunState, pair: results.PairKey) -> Sequence[str]:
    coarse, found = state.coarse.get(pair), state.registrations.get(pair)
    matches = state.matches.get(pair)
    graph = ("-", "-") if coarse is None else (f"{coarse.graph_nodes:,}", f"{coarse.graph_edges:,}")
    counts = (pair_label(*state.registered(pair)), "-" if matches is None else f"{len(matches):,}", *graph)
    if found is None:
        return (*counts, "-", "-", "-", "no pose", "-")
    reasons = ", ".join(found.verdict.codes).replace("_", " ") or "-"
    violate = f"{found.registrations[0].visibility.violation_share:.1%}" if found.registrations else "-"
    return (*counts, f"{found.fitness:.3f}", f"{found.coverage:.3f}", violate, found.verdict.outcome, reasons)


def pair_scores_markdown(
    state: RunState, pair: results.PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]
) -> str:
    """Describe the verdict and the search; add a row per pose, the one with the most evidence first.

    Args:
        shown: the pose that the view shows at this step; its row is bold.
        shown_at: the step at which each pose is shown.
    """
    found, coarse = state.registrations.get(pair), state.coarse.get(pair)
    parts = [f"# {pair_label(*state.registered(pair))}"]
    if found is not None:
        parts.append("\n- ".join([f"**{found.verdict.outcome}**", *(reason.text for reason in found.verdict.reasons)]))
    if coarse is not None:
        graph = f"consistency graph: {coarse.graph_nodes:,} nodes, {coarse.graph_edges:,} edges; "
        matches = f"{len(state.matches.get(pair, ())):,} matches; {graph if coarse.graph_nodes else ''}"
        parts.append(f"{matches}hypotheses: {len(coarse.hypotheses)}")
    rows = _score_rows(state, pair, shown, shown_at)
    parts += [markdown_table(_SCORES_HEADER, rows)] if rows else []
    return "\n\n".join([*parts, *_opposite_scores(state, pair), _SCORES_LEGEND])


def _opposite_scores(state: RunState, pair: results.PairKey) -> Iterator[str]:
    """Name target and source of the scores after a short GICP, if those of the registration are exchanged."""
    verified, registered = state.verified.get(pair, ()), state.registered(pair)
    if any(one.T_target_source.target != registered[0] for one in verified):
        yield f"Fitness and RMSE after a short GICP are those of {pair_label(*reversed(registered))}."


def _score_rows(
    state: RunState, pair: results.PairKey, shown: Shown | None, shown_at: Mapping[Shown, int]
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


def _matches(one: results.Registration, hypotheses: Sequence[results.Hypothesis]) -> str:
    """Return how many matches agree with the hypothesis; "-" for a pose that does not come from matches."""
    index = one.hypothesis
    return f"{hypotheses[index].score:g}" if 0 <= index < len(hypotheses) and not one.derivation else "-"


def _scores(one: results.Registration) -> Sequence[str]:
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


def _hypothesis_rows(state: RunState, pair: results.PairKey) -> Iterable[Sequence[str]]:
    label = pair_label(*state.registered(pair))
    hypotheses = state.coarse[pair].hypotheses if pair in state.coarse else ()
    found, verified = state.registrations.get(pair), state.verified.get(pair, ())
    scored = verified or (() if found is None else found.registrations)
    prior = [one for one in scored if one.origin == results.PRIOR]
    for one in dict.fromkeys([*scored[:_SHOWN_HYPOTHESES], *prior]):
        fit = _fit(found if found is not None and found.start_name == one.name else None)
        agree, violate, _, evidence, *_ = _scores(one)
        yield (label, one.name, _matches(one, hypotheses), agree, violate, evidence, *fit)
    if scored:
        return
    for guess in hypotheses[:_SHOWN_HYPOTHESES]:
        fit = _fit(found if found is not None and found.hypothesis == guess.index else None)
        yield (label, guess.name, f"{guess.score:g}", *("-",) * 3, *fit)
    if not hypotheses:
        yield (label, "none", f"0 of {len(state.matches.get(pair, ()))}", *("-",) * 6)


def _fit(found: results.PairRegistration | None) -> Sequence[str]:
    if found is None:
        return ("-",) * 3
    return (thousandths(found.fitness), thousandths(found.rmse_m), found.verdict.outcome)


def decisions_markdown(decisions: Sequence[results.MergeDecision], *, by_evidence: bool) -> str:
    """Tabulate the merge steps, the latest first; evidence ranks the candidates or, without verification, fitness."""
    return "\n\n".join([*(_decision_part(decision, by_evidence) for decision in reversed(decisions)), _RMSE_NOTE])


def _decision_part(decision: results.MergeDecision, by_evidence: bool) -> str:
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


def candidate_label(one: results.MergeCandidate) -> str:
    """Return the name of a pair, or of two groups by their roots."""
    label = pair_label(one.target, one.source)
    return f"{label} (groups)" if one.of_groups else label


def _candidate_verdict(one: results.MergeCandidate, chosen: results.MergeCandidate | None) -> str:
    if one == chosen:
        return "merged, uncertain" if one.uncertain else "merged"
    return "passes" if one.passes else "uncertain" if one.uncertain else "does not pass"


def summary_markdown(state: RunState, ended_by: str = "") -> str:
    """Summarise the outcome, or the progress of a run that has none yet, with the reason if it ended early."""
    document = state.document
    parts = [
        *_explanation_parts(explain(document)),
        f"The run ended early: **{escaped(ended_by)}**" if ended_by else "",
        *_result_parts(document),
        _input_part(document),
        ", ".join(f"{package} {version}" for package, version in document.versions.items()),
    ]
    return "\n\n".join(part for part in parts if part)


def _explanation_parts(explanation: Explanation) -> Iterator[str]:
    yield f"# {explanation.headline}"
    if explanation.warnings:
        yield "\n".join(f"- **Warning**: {warning}" for warning in explanation.warnings)
    if explanation.known:
        yield "\n".join(f"- {known}" for known in explanation.known)
    for each in explanation.unclear:
        yield "\n".join([f"- **{each.headline}**", *(f"  - {detail}" for detail in each.details)])
    if explanation.advice:
        yield "\n".join(f"- What helps: {advice}." for advice in explanation.advice)


def _result_parts(document: ResultDocument) -> Iterator[str]:
    if document.status == "unfinished" or document.refusal is not None:
        return
    if {*document.poses} - {document.target}:
        yield f"Target: **{escaped(document.target)}** ({escaped(document.target_reason)})"
    yield markdown_table(_PLACEMENT_HEADER, [_placement_row(name, entry) for name, entry in document.lidars.items()])
    if any(entry.covariance is not None for entry in document.lidars.values()):
        scale = ellipsoid_scale(document)
        yield f"Ellipsoids of the rig: {SIGMAS:g} sigma of the position, {scale:g} times enlarged."
    if document.snapshots:
        yield "\n".join(f"- snapshot **{escaped(each.name)}**: {escaped(each.text)}" for each in document.snapshots)
    if document.stops:
        used = sum(link.used for link in document.links)
        names = ", ".join(escaped(each.name) for each in document.stops)
        yield f"Stops: {names}, with {used} of {len(document.links)} links between them used."
    if document.motions:
        used = sum(motion.used for motion in document.motions)
        yield f"Motions of LiDARs between stops, by odometry: {used} of {len(document.motions)} used."
    if document.ground is not None:
        yield f"Ground, frame {escaped(document.ground.frame)}: {escaped(document.ground.text)}."


def _placement_row(name: str, entry: LidarEntry) -> Sequence[str]:
    if entry.xyz_m is None or entry.rpy_deg is None:
        return (f"{name} (**not placed**)", *("-",) * 8)
    numbers = (*(f"{value:z.3f}" for value in entry.xyz_m), *(f"{value:z.2f}" for value in entry.rpy_deg))
    sigmas = ("-", "-")
    if (largest := entry.largest_sigmas) is not None:
        sigmas = (f"{1e3 * largest[0]:.1f}", f"{largest[1]:.3f}")
    return (f"{name} (**uncertain**)" if entry.status == "uncertain" else name, *numbers, *sigmas)


def _input_part(document: ResultDocument) -> str:
    source = document.input
    rows = [(name, lidar.topic or "-", str(lidar.frames), f"{lidar.points:,}") for name, lidar in source.lidars.items()]
    digest = source.sha256[:16] or "none"
    table = markdown_table(("LiDAR", "topic", "frames", "points"), rows)
    return f"## Input\n\n`{source.source or 'in memory'}`, sha256 `{digest}`\n\n{table}"
