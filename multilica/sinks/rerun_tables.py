# SPDX-License-Identifier: Apache-2.0
"""Comparisons of all pairs at once."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.sinks.palette import heat_colours
from multilica.sinks.rerun_scene import Scene
from multilica.sinks.rerun_tree import FITNESS, HYPOTHESES_TABLE, RESULT, SUMMARY
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory
from multilica.sinks.run_summary import fitness_markdown, hypotheses_markdown, summary_markdown

__all__ = ["log_pair_tables", "log_summary"]

_CELL_PIXELS = 20


def log_summary(scene: Scene) -> None:
    """The outcome, or how far the run is: for people, and as the result document for programs.

    The document comes without the times that stages took, so that equal runs make equal recordings.
    """
    scene.log(SUMMARY, _markdown(summary_markdown(scene.story)))
    document = run_document(scene.story)
    if document is not None:
        text = json.dumps({**document, "timing_s": {}}, ensure_ascii=False, allow_nan=False)
        scene.log(RESULT, rr.TextDocument(text, media_type=rr.MediaType.TEXT))


def log_pair_tables(scene: Scene) -> None:
    """Hypotheses and fitness of all pairs, as far as they are known."""
    story = scene.story
    if story.coarse:
        scene.log(HYPOTHESES_TABLE, _markdown(hypotheses_markdown(story)))
    if story.registrations:
        shares = _fitness_matrix(story)
        scene.log(FITNESS, rr.Tensor(shares.astype(np.float32), dim_names=("target", "source")))
        scene.log(f"{FITNESS}/table", _markdown(fitness_markdown(story)))
        _log_picture(scene, shares)


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _fitness_matrix(story: RunStory) -> npt.NDArray[np.float64]:
    """(N, N) fitness, target in rows, source in columns; NaN where no pair was registered."""
    index = {name: row for row, name in enumerate(story.lidars)}
    shares = np.full((len(index), len(index)), np.nan)
    for registration in story.registrations.values():
        shares[index[registration.target], index[registration.source]] = registration.fitness
    return shares


def _log_picture(scene: Scene, shares: npt.NDArray[np.float64]) -> None:
    colours = heat_colours(shares).repeat(_CELL_PIXELS, axis=0).repeat(_CELL_PIXELS, axis=1)
    scene.log(f"{FITNESS}/picture", rr.Image(colours))
    names = scene.story.lidars
    cells = [(f"{shares[row, column]:.2f}", (column, row)) for row, column in np.argwhere(np.isfinite(shares))]
    rows = [(name, (-1, row)) for row, name in enumerate(names)]
    columns = [(name, (column, -1)) for column, name in enumerate(names)]
    labels, at = zip(*cells, *rows, *columns, strict=True)
    positions = (np.array(at, dtype=np.float32) + 0.5) * _CELL_PIXELS
    points = rr.Points2D(positions, labels=list(labels), radii=[0.01], colors=[(255, 255, 255)], show_labels=True)
    scene.log(f"{FITNESS}/labels", points)
