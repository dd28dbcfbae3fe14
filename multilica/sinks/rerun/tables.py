# SPDX-License-Identifier: Apache-2.0
"""Figures of a recording, as data for programs and as tables for people."""

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import rerun as rr

from multilica import events
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Correspondences, MergeCandidate, MergeDecision, PairKey, PairRegistration, PairResidual
from multilica.sinks.drawing import VERDICT_COLOURS, heat_colours, sample_indices
from multilica.sinks.rerun.lidars import log_in_slot
from multilica.sinks.rerun.scene import (
    CLOCK_TIMELINE,
    COVERAGE,
    FITNESS,
    HYPOTHESES_TABLE,
    MERGE_TABLE,
    PAIR_TABLE,
    PAIRS_TABLE,
    RESULT,
    SUMMARY,
    TIMINGS,
    VERDICTS,
    RerunScene,
    pair_path,
)
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.text.markdown import hypotheses_markdown, pair_figures_markdown, summary_markdown

_CELL_PIXELS = np.array([60, 20])
_LABEL_SHARE = 0.05
Cells = dict[tuple[int, int], PairRegistration]
"""Registered pairs by row of the target and column of the source, in this order."""
_TEXT, _COUNT, _NUMBER, _FLAG = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_OF_CANDIDATE = ("target", "source", "evidence", "fitness", "rmse_m", "reason", "of_groups")
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
PAIR_COLUMNS: Mapping[str, pa.DataType] = {
    **dict.fromkeys(("target", "source"), _TEXT),
    **dict.fromkeys(("matches", "hypotheses"), _COUNT),
    **dict.fromkeys(("pose_from", "verdict", "reasons"), _TEXT),
    **dict.fromkeys(("evidence", "fitness", "rmse_m", "coverage", "violation_share", "sigma_m", "sigma_deg"), _NUMBER),
    **dict.fromkeys(("rig_residual_m", "rig_residual_deg", "rig_weight", *_POSE), _NUMBER),
}
"""Columns of the table of pairs; a figure that is not known is null, a text empty.

Target and source are those of the registration, to which the pose `T_target_source` and the figures belong.
"""
MERGE_COLUMNS: Mapping[str, pa.DataType] = {
    **dict.fromkeys(("merge_step", "rank"), _COUNT),
    **dict.fromkeys(("target", "source"), _TEXT),
    **dict.fromkeys(("evidence", "fitness", "rmse_m"), _NUMBER),
    **dict.fromkeys(("verdict", "reason"), _TEXT),
    **dict.fromkeys(("chosen", "of_groups"), _FLAG),
}
"""Columns of the table of merge candidates; steps and ranks count from 1."""


def log_timings(scene: RerunScene) -> None:
    """Log the name of each stage at its start and end, back to back up to now, on the wall clock alone.

    Equal runs differ on that timeline only. The frames of the LiDARs are always logged again, at the earliest time:
    views need them there if the stages took longer than the recording, as after a slow reading.
    """
    known_s = {stage: seconds for stage, seconds in scene.state.document.timing_s.items() if seconds is not None}
    if not known_s:
        return
    seconds = np.array(list(known_s.values()))
    ends_s = np.cumsum(seconds)
    edges_s = np.stack([ends_s - seconds, ends_s], axis=1).ravel() - ends_s[-1]
    times = (time.time_ns() + (1e9 * edges_s).astype(np.int64)).astype("datetime64[ns]")
    names = [stage for stage in known_s for _ in ("start", "end")]
    columns = rr.AnyValues.columns(stage=pa.array(names))
    scene.stream.send_columns(TIMINGS, [rr.TimeColumn(CLOCK_TIMELINE, timestamp=times)], columns)
    earliest = np.minimum(times[:1], np.datetime64(scene.started_ns, "ns"))
    for lidar in scene.state.lidars:
        log_in_slot(scene, lidar, [rr.TimeColumn(CLOCK_TIMELINE, timestamp=earliest)])


def log_matched(scene: RerunScene, event: events.CorrespondencesMatched) -> None:
    """Log the number of matches of a pair, and the matches in their own frames; `--record full` keeps all."""
    matches = event.correspondences
    _log_scalars(scene, (matches.target, matches.source), "correspond", {"matches": len(matches)})
    rows = sample_indices(len(matches), scene.limits_of((matches.target, matches.source)).match_rows)
    values = rr.AnyValues(
        target_index=pa.array(matches.target_index[rows], pa.int32()),
        source_index=pa.array(matches.source_index[rows], pa.int32()),
        target_point_m=_points(matches.target_points_m[rows]),
        source_point_m=_points(matches.source_points_m[rows]),
        feature_distance=pa.array(matches.feature_distances[rows], pa.float32()),
    )
    scene.log(_data_path(matches), values)


def log_hypotheses(scene: RerunScene, event: events.HypothesesFound) -> None:
    """Log the figures of a pair's hypotheses, and which of them each match agrees with."""
    matches, found = event.correspondences, event.coarse.hypotheses
    figures = {"hypotheses": len(found), "agreeing_matches": found[0].score if found else 0.0}
    _log_scalars(scene, (event.coarse.target, event.coarse.source), "coarse", figures)
    told = [one.inliers if len(one.inliers) else np.zeros(len(matches), dtype=np.bool_) for one in found]
    agree = (
        np.array(told, dtype=np.bool_)
        .reshape(len(told), len(matches))
        .T[sample_indices(len(matches), scene.limits_of((matches.target, matches.source)).match_rows)]
    )
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(agree, axis=1))])
    lists = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), pa.array(np.nonzero(agree)[1], pa.int32()))
    scene.log(_data_path(matches), rr.AnyValues(agrees_with=lists))


def log_verified(scene: RerunScene, event: events.HypothesesVerified) -> None:
    """Log the figures of the hypothesis with the most evidence."""
    if event.registrations:
        _log_scalars(scene, (event.target, event.source), "verify", event.registrations[0].figures)


def log_registration(
    scene: RerunScene, event: events.PairRegistered | events.VerdictChanged | events.LoopRegistered
) -> None:
    """Log the figures of a registered pair, and the residuals of its matches; none of a refused loop."""
    found = event.registration
    if isinstance(event, events.LoopRegistered) and not found.verdict.accepted:
        return
    pair = scene.state.pair_of(found)
    _log_scalars(scene, pair, "fine", found.figures)
    _log_residuals(scene, pair, found.T_target_source)


def candidate_pairs(state: RunState) -> tuple[PairKey, ...]:
    """Return the pairs of two LiDARs that a merge step could have chosen, in name order."""
    candidates = [one for decision in state.decisions for one in decision.candidates if not one.of_groups]
    return tuple(sorted({state.pair_of(one) for one in candidates}))


def log_candidates(scene: RerunScene, event: events.MergeStepTaken) -> None:
    """Log the figures of the candidates of a merge step."""
    for one in event.decision.candidates:
        if not one.of_groups:
            _log_style(scene, one)
        figures = {"evidence": one.evidence, "fitness": one.fitness, "rmse_m": one.rmse_m}
        stage = "merge_groups" if one.of_groups else "merge"
        _log_scalars(scene, scene.state.pair_of(one), stage, figures)


def _log_style(scene: RerunScene, candidate: MergeCandidate) -> None:
    """Log name and colour of the candidate's series, once."""
    path = pair_path(*scene.state.pair_of(candidate), "merge", "evidence")
    if path in scene.shown:
        return
    scene.shown.add(path)
    label, colour = (each(candidate.target, candidate.source) for each in (pair_label, scene.pair_colour))
    lines = rr.SeriesLines(names=label, colors=colour)
    scene.log(path, lines, rr.SeriesPoints(names=label, colors=colour, marker_sizes=5.0))


def log_refined(scene: RerunScene, event: events.RigRefined) -> None:
    """Log how far the poses are from each registered pair."""
    for each in event.refinement.pairs:
        figures = {
            "residual_m": each.after_m,
            "residual_deg": each.after_deg,
            "weight": each.weight,
            "probability": each.probability,
        }
        _log_scalars(scene, scene.state.pair_of(each), "refine", figures)


def _log_scalars(scene: RerunScene, pair: PairKey, stage: str, figures: Mapping[str, float | None]) -> None:
    for name, value in figures.items():
        if value is not None and math.isfinite(value):
            scene.log(pair_path(*pair, stage, name), rr.Scalars(float(value)))


def _log_residuals(scene: RerunScene, pair: PairKey, pose: RigidTransform) -> None:
    """Log the distance of the two points of each match at a pose."""
    matches = scene.state.matches.get(pair)
    if matches is None:
        return
    rows = sample_indices(len(matches), scene.limits_of(pair).match_rows)
    moved_m = pose.with_target(pair[0]).apply(matches.source_points_m[rows])
    residual_m = np.linalg.norm(moved_m - matches.target_points_m[rows], axis=1)
    scene.log(_data_path(matches), rr.AnyValues(residual_m=pa.array(residual_m, pa.float32())))


def log_surface_matches(scene: RerunScene, event: events.SurfacesMatched) -> None:
    """Log the matches of surfaces at the final pose."""
    found = event.matches
    pair = scene.state.pair_of(found)
    points = (found.target_points_m, found.source_points_m)
    of_target, of_source = points if found.target == pair[0] else points[::-1]
    rows = sample_indices(len(found), scene.limits_of(pair).match_rows)
    values = rr.AnyValues(
        target_point_m=_points(of_target[rows]),
        source_point_m=_points(of_source[rows]),
        distance_m=pa.array(found.distance_m[rows], pa.float32()),
        plane_distance_m=pa.array(found.plane_distance_m[rows], pa.float32()),
    )
    scene.log(pair_path(*pair, "fine", "matches"), values)
    _log_residuals(scene, pair, found.T_target_source)


def _data_path(matches: Correspondences) -> str:
    return pair_path(matches.target, matches.source, "matches", "data")


def _points(points_m: npt.NDArray[np.floating]) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(points_m.astype(np.float32).ravel()), 3)


def log_data_tables(scene: RerunScene) -> None:
    """Log one row per pair that was matched or registered, and one per candidate of each merge step."""
    state = scene.state
    if state.pairs:
        refined = () if state.document.refinement is None else state.document.refinement.pairs
        residuals = {state.pair_of(each): each for each in refined}
        rows = [_pair_row(state, pair, residuals.get(pair)) for pair in state.pairs]
        _log_rows(scene, PAIR_TABLE, PAIR_COLUMNS, rows)
    if state.decisions:
        _log_rows(scene, MERGE_TABLE, MERGE_COLUMNS, _merge_rows(state.decisions))


def _log_rows(
    scene: RerunScene, path: str, columns: Mapping[str, pa.DataType], rows: Sequence[Mapping[str, object]]
) -> None:
    """Log a table as one cell per column, so that the latest row of the entity is the whole table."""
    # Null where a number is not known: NaN would make equal recordings differ.
    arrays = {name: pa.array([_known(row.get(name)) for row in rows], kind) for name, kind in columns.items()}
    scene.log(path, rr.AnyValues(**arrays))


def _known(value: object) -> object:
    """Return the value; None for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _pair_row(state: RunState, pair: PairKey, residual: PairResidual | None) -> dict[str, object]:
    found, coarse, matches = state.registrations.get(pair), state.coarse.get(pair), state.matches.get(pair)
    row: dict[str, object] = dict(zip(("target", "source"), state.registered(pair), strict=True))
    row |= {"matches": None if matches is None else len(matches)}
    row |= {"hypotheses": None if coarse is None else len(coarse.hypotheses)}
    row |= {"pose_from": "", "verdict": "no pose", "reasons": ""}
    if found is not None:
        pose, reasons = found.T_target_source, ",".join(found.verdict.codes)
        row |= {"pose_from": found.start_name, "verdict": found.verdict.outcome, "reasons": reasons, **found.figures}
        row |= zip(_POSE, (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist()), strict=True)
    if residual is not None:
        row |= {"rig_residual_m": residual.after_m, "rig_residual_deg": residual.after_deg}
        row["rig_weight"] = residual.weight
    return row


def _merge_rows(decisions: Sequence[MergeDecision]) -> list[dict[str, object]]:
    """Return a row per merge step and candidate, in the order in which they were ranked."""
    return [
        {
            "merge_step": decision.step + 1,
            "rank": rank,
            **{name: getattr(one, name) for name in _OF_CANDIDATE},
            "verdict": "accept" if one.passes else "uncertain" if one.uncertain else "refused",
            "chosen": one == decision.chosen,
        }
        for decision in decisions
        for rank, one in enumerate(decision.candidates, start=1)
    ]


def log_summary(scene: RerunScene, ended_by: str = "") -> None:
    """Log the summary for people, and the result document for programs.

    The document has no stage times, so that equal runs make equal recordings.
    """
    scene.log_document(SUMMARY, summary_markdown(scene.state, ended_by))
    text = scene.state.document.model_copy(update={"timing_s": {}}).model_dump_json()
    scene.log(RESULT, rr.TextDocument(text, media_type=rr.MediaType.TEXT))


def log_pair_tables(scene: RerunScene) -> None:
    """Log hypotheses, fitness, coverage and verdicts of all pairs so far."""
    state = scene.state
    if state.coarse:
        scene.log_document(HYPOTHESES_TABLE, hypotheses_markdown(state))
    if state.registrations:
        scene.log_document(PAIRS_TABLE, pair_figures_markdown(state))
        index = {name: row for row, name in enumerate(state.lidars)}
        found = {(index[pair.target], index[pair.source]): pair for pair in state.registrations.values()}
        cells = dict(sorted(found.items(), key=lambda each: each[0]))
        _log_shares(scene, FITNESS, cells, [pair.fitness for pair in cells.values()])
        _log_shares(scene, COVERAGE, cells, [pair.coverage for pair in cells.values()])
        outcomes = [pair.verdict.outcome for pair in cells.values()]
        colours = heat_colours(np.full((len(index),) * 2, np.nan))
        for cell, outcome in zip(cells, outcomes, strict=True):
            colours[cell] = VERDICT_COLOURS[outcome]
        _log_picture(scene, VERDICTS, colours, cells, outcomes)


def matrix_bounds(lidars: int) -> FloatArray:
    """Return the upper left and the lower right corner (2, 2) in pixels of a picture of all pairs with its names."""
    bounds: FloatArray = np.array([[-1.0, -1.0], [lidars, lidars + 0.1]]) * _CELL_PIXELS
    return bounds


def _log_shares(scene: RerunScene, path: str, cells: Cells, shares: list[float]) -> None:
    values = np.full((len(scene.state.lidars),) * 2, np.nan)
    values[tuple(zip(*cells, strict=True))] = shares
    scene.log(path, rr.Tensor(values.astype(np.float32), dim_names=("target", "source")))
    _log_picture(scene, path, heat_colours(values), cells, [f"{share:.2f}" for share in shares])


def _log_picture(
    scene: RerunScene, path: str, colours: npt.NDArray[np.uint8], cells: Cells, texts: Sequence[str]
) -> None:
    """Log a square per pair with its text, and the names along both sides."""
    width, height = _CELL_PIXELS
    scene.log(f"{path}/picture", rr.Image(colours.repeat(height, axis=0).repeat(width, axis=1)))
    names = scene.state.lidars
    rows, columns = [(-1, row) for row in range(len(names))], [(column, -1) for column in range(len(names))]
    at = [(source, target) for target, source in cells] + rows + columns
    # The viewer draws a text below its point; the more rows, the larger it is beside a cell.
    raised = min(0.45, _LABEL_SHARE * (len(names) + 1))
    positions = (np.array(at, dtype=np.float32) + np.array([0.5, 0.5 - raised])) * _CELL_PIXELS
    labels = [*texts, *names, *names]
    points = rr.Points2D(positions, labels=labels, radii=[0.01], colors=[(255, 255, 255)], show_labels=True)
    scene.log(f"{path}/labels", points)
