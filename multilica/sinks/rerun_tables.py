# SPDX-License-Identifier: Apache-2.0
"""Comparisons of all pairs at once."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.sinks.pair_matrix import (
    PairMatrix,
    coverage_matrix,
    fitness_matrix,
    pair_figures_markdown,
    verdict_matrix,
)
from multilica.sinks.palette import VERDICT_COLOURS, heat_colours
from multilica.sinks.rerun_scene import Scene
from multilica.sinks.rerun_tree import (
    COVERAGE,
    FITNESS,
    HYPOTHESES_TABLE,
    PAIRS_TABLE,
    RESULT,
    SUMMARY,
    VERDICTS,
)
from multilica.sinks.run_document import run_document
from multilica.sinks.run_summary import hypotheses_markdown, summary_markdown

__all__ = ["log_pair_tables", "log_summary"]

_CELL_PIXELS = 20


def log_summary(scene: Scene, ended_by: str = "") -> None:
    """The outcome, or how far the run is and what ended it early: for people, and as the result document for programs.

    The document comes without the times that stages took, so that equal runs make equal recordings.
    """
    document = run_document(scene.story)
    scene.log_document(SUMMARY, summary_markdown(scene.story, document, ended_by))
    if document is not None:
        text = json.dumps({**document, "timing_s": {}}, ensure_ascii=False, allow_nan=False)
        scene.log(RESULT, rr.TextDocument(text, media_type=rr.MediaType.TEXT))


def log_pair_tables(scene: Scene) -> None:
    """Hypotheses, fitness, coverage and verdicts of all pairs, as far as they are known."""
    story = scene.story
    if story.coarse:
        scene.log_document(HYPOTHESES_TABLE, hypotheses_markdown(story))
    if story.registrations:
        scene.log_document(PAIRS_TABLE, pair_figures_markdown(story))
        _log_shares(scene, FITNESS, fitness_matrix(story))
        _log_shares(scene, COVERAGE, coverage_matrix(story))
        _log_verdicts(scene, verdict_matrix(story))


def _log_shares(scene: Scene, path: str, matrix: PairMatrix) -> None:
    scene.log(path, rr.Tensor(matrix.values.astype(np.float32), dim_names=("target", "source")))
    _log_picture(scene, path, matrix, heat_colours(matrix.values))


def _log_verdicts(scene: Scene, matrix: PairMatrix) -> None:
    colours = heat_colours(np.full_like(matrix.values, np.nan))
    for code, colour in enumerate(VERDICT_COLOURS.values()):
        colours[matrix.values == code] = colour
    _log_picture(scene, VERDICTS, matrix, colours)


def _log_picture(scene: Scene, path: str, matrix: PairMatrix, colours: npt.NDArray[np.uint8]) -> None:
    """A square per pair with its figure, the names along both sides."""
    scene.log(f"{path}/picture", rr.Image(colours.repeat(_CELL_PIXELS, axis=0).repeat(_CELL_PIXELS, axis=1)))
    cells = [(matrix.texts[target, source], (source, target)) for target, source in sorted(matrix.texts)]
    rows = [(name, (-1, row)) for row, name in enumerate(matrix.names)]
    columns = [(name, (column, -1)) for column, name in enumerate(matrix.names)]
    labels, at = zip(*cells, *rows, *columns, strict=True)
    positions = (np.array(at, dtype=np.float32) + 0.5) * _CELL_PIXELS
    points = rr.Points2D(positions, labels=list(labels), radii=[0.01], colors=[(255, 255, 255)], show_labels=True)
    scene.log(f"{path}/labels", points)
