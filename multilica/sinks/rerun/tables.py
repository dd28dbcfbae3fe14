# SPDX-License-Identifier: Apache-2.0
"""Tables of a recording: of all pairs, of the merge, and the summary."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import rerun as rr

from multilica.geometry import FloatArray
from multilica.results import MergeDecision, PairKey, PairRegistration, PairResidual
from multilica.sinks.drawing.palette import VERDICT_COLOURS, heat_colours
from multilica.sinks.rerun.entity_paths import (
    COVERAGE,
    FITNESS,
    HYPOTHESES_TABLE,
    MERGE_TABLE,
    PAIR_TABLE,
    PAIRS_TABLE,
    RESULT,
    SUMMARY,
    VERDICTS,
)
from multilica.sinks.rerun.scene import RerunScene
from multilica.sinks.run_state import RunState
from multilica.sinks.text.markdown import hypotheses_markdown, pair_figures_markdown, summary_markdown

_CELL_PIXELS = np.array([60, 20])
_LABEL_SHARE = 0.05
Cells = dict[tuple[int, int], PairRegistration]
"""Registered pairs by row of the target and column of the source, in this order."""

_TEXT, _COUNT, _NUMBER, _FLAG = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_OF_CANDIDATE = ("target", "source", "evidence", "fitness", "rmse_m", "reason", "of_groups")
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")

PAIR_COLUMNS: Mapping[str, pa.DataType] = MappingProxyType(
    {
        **dict.fromkeys(("target", "source"), _TEXT),
        **dict.fromkeys(("matches", "hypotheses"), _COUNT),
        **dict.fromkeys(("pose_from", "verdict", "reasons"), _TEXT),
        **dict.fromkeys(
            ("evidence", "fitness", "rmse_m", "coverage", "violation_share", "sigma_m", "sigma_deg"), _NUMBER
        ),
        **dict.fromkeys(("rig_residual_m", "rig_residual_deg", "rig_weight", *_POSE), _NUMBER),
    }
)
"""Columns of the table of pairs; a figure that is not known is null, a text empty. The pose is `T_target_source`."""
MERGE_COLUMNS: Mapping[str, pa.DataType] = MappingProxyType(
    {
        **dict.fromkeys(("merge_step", "rank"), _COUNT),
        **dict.fromkeys(("target", "source"), _TEXT),
        **dict.fromkeys(("evidence", "fitness", "rmse_m"), _NUMBER),
        **dict.fromkeys(("verdict", "reason"), _TEXT),
        **dict.fromkeys(("chosen", "of_groups"), _FLAG),
    }
)
"""Columns of the table of merge candidates; steps and ranks count from 1."""


def log_data_tables(scene: RerunScene) -> None:
    """Log one row per pair that was matched or registered, and one per candidate of each merge step."""
    if scene.state.pairs:
        _log_rows(scene, PAIR_TABLE, PAIR_COLUMNS, _pair_rows(scene.state))
    if scene.state.decisions:
        _log_rows(scene, MERGE_TABLE, MERGE_COLUMNS, _merge_rows(scene.state.decisions))


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


def _pair_rows(state: RunState) -> list[dict[str, object]]:
    refinement = state.document.refinement
    refined = () if refinement is None else refinement.pairs
    residuals = {state.key_of(each.target, each.source): each for each in refined}
    return [_pair_row(state, pair, residuals.get(pair)) for pair in state.pairs]


def _pair_row(state: RunState, pair: PairKey, residual: PairResidual | None) -> dict[str, object]:
    found, coarse = state.registrations.get(pair), state.coarse.get(pair)
    row: dict[str, object] = {
        "target": pair[0],
        "source": pair[1],
        "matches": len(state.matches.get(pair, ())),
        "hypotheses": 0 if coarse is None else len(coarse.hypotheses),
        "pose_from": "",
        "verdict": "no pose",
        "reasons": "",
    }
    if found is not None:
        pose = found.T_target_source.with_target(pair[0])
        row |= {"pose_from": found.start_name, "verdict": found.verdict.outcome, **found.figures}
        row["reasons"] = ",".join(found.verdict.codes)
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
        _log_verdicts(scene, cells)


def matrix_bounds(lidars: int) -> FloatArray:
    """Return the upper left and the lower right corner (2, 2) in pixels of a picture of all pairs with its names."""
    bounds: FloatArray = np.array([[-1.0, -1.0], [lidars, lidars + 0.1]]) * _CELL_PIXELS
    return bounds


def _log_shares(scene: RerunScene, path: str, cells: Cells, shares: list[float]) -> None:
    values = np.full((len(scene.state.lidars),) * 2, np.nan)
    values[tuple(zip(*cells, strict=True))] = shares
    scene.log(path, rr.Tensor(values.astype(np.float32), dim_names=("target", "source")))
    _log_picture(scene, path, heat_colours(values), cells, [f"{share:.2f}" for share in shares])


def _log_verdicts(scene: RerunScene, cells: Cells) -> None:
    colours = heat_colours(np.full((len(scene.state.lidars),) * 2, np.nan))
    outcomes = [pair.verdict.outcome for pair in cells.values()]
    for cell, outcome in zip(cells, outcomes, strict=True):
        colours[cell] = VERDICT_COLOURS[outcome]
    _log_picture(scene, VERDICTS, colours, cells, outcomes)


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
