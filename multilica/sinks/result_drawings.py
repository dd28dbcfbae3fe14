# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration as drawings, by topic."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import BoolArray, CalibrationResult, Correspondences
from multilica.sinks.drawing import Drawing, Ellipsoid, Label, Lines, segments_along
from multilica.sinks.field_of_view import shown_field_of_view
from multilica.sinks.kept_matches import kept_matches
from multilica.sinks.narration import pair_label
from multilica.sinks.palette import KEPT, REJECTED, VERDICT_COLOURS, VIOLATE, distinct_colours
from multilica.sinks.run_story import RunStory, as_matched
from multilica.sinks.thinning import sample_indices
from multilica.sinks.uncertainty import SHOWN_ELLIPSOID_SCALE, uncertainty_ellipsoid

__all__ = ["DRAWING_TOPICS", "result_drawings"]

DRAWING_TOPICS = ("/matches", "/merge_graph", "/fields_of_view", "/uncertainty")

_MAX_MATCHES = 500
_WAITING_HEIGHT_M = 1.5
_NODE_RADIUS_M = 0.06
_LABEL_POSITION = 0.4
"""Share of the way along an edge; off the middle, where the diagonals of a square would meet."""


def result_drawings(story: RunStory, result: CalibrationResult) -> Mapping[str, tuple[Drawing, ...]]:
    """Per topic of `DRAWING_TOPICS` what it holds."""
    drawings = (_matches(story), _merge_graph(story, result), _fields_of_view(story), _uncertainty(story, result))
    return {topic: tuple(found) for topic, found in zip(DRAWING_TOPICS, drawings, strict=True)}


def _matches(story: RunStory) -> Iterator[Drawing]:
    """Per pair a sample of its matches, at its best pose: kept ones are short, rejected ones long."""
    for pair, matches in sorted(story.matches.items()):
        coarse, found = story.coarse.get(pair), story.registrations.get(pair)
        if coarse is None or not coarse.hypotheses:
            continue
        index = max(found.hypothesis, 0) if found is not None else 0
        hypothesis = coarse.hypotheses[index]
        pose = as_matched(pair, found.T_target_source) if found is not None else hypothesis.T_target_source
        kept = kept_matches(story, matches, hypothesis)
        lines = (Lines(_some(matches, kept, pose), KEPT), Lines(_some(matches, ~kept, pose), REJECTED))
        yield Drawing(pair_label(*pair), matches.target, lines)


def _some(matches: Correspondences, chosen: BoolArray, pose: RigidTransform) -> FloatArray:
    """(K, 2, 3) from the target's point to the source's at that pose."""
    rows = np.flatnonzero(chosen)
    rows = rows[sample_indices(len(rows), _MAX_MATCHES)]
    return np.stack([matches.target_points_m[rows], pose.apply(matches.source_points_m[rows])], axis=1)


def _merge_graph(story: RunStory, result: CalibrationResult) -> Iterator[Drawing]:
    """A node per LiDAR, an edge per registered pair with its fitness and verdict."""
    places_m = _places_m(result)
    colours = distinct_colours(story.lidars)
    for place in result.placements:
        text = place.lidar if place.placed else f"{place.lidar}: not placed"
        colour = colours[place.lidar] if place.placed else VIOLATE
        label = Label(places_m[place.lidar] + np.array([0.0, 0.0, 2.0 * _NODE_RADIUS_M]), text, colour)
        yield Drawing(place.lidar, result.target, labels=(label,), lines=(_cross(places_m[place.lidar], colour),))
    for pair, found in sorted(story.registrations.items()):
        start_m, end_m = places_m[pair[0]], places_m[pair[1]]
        colour = VERDICT_COLOURS[found.verdict.outcome]
        text = f"{found.fitness:.2f} {found.verdict.outcome}"
        label = Label(start_m + _LABEL_POSITION * (end_m - start_m), text, colour)
        edge = Lines(np.stack([start_m, end_m])[None], colour)
        yield Drawing(pair_label(*pair), result.target, (edge,), labels=(label,))


def _places_m(result: CalibrationResult) -> dict[str, FloatArray]:
    """Where the LiDARs are in the target's frame; those that are not placed wait above it."""
    places_m = {place.lidar: place.T_target_source.xyz_m for place in result.placements if place.T_target_source}
    waiting = [place.lidar for place in result.placements if place.lidar not in places_m]
    above_m = {name: np.array([0.0, 0.0, _WAITING_HEIGHT_M * (1 + row)]) for row, name in enumerate(waiting)}
    return {**places_m, **above_m}


def _cross(centre_m: FloatArray, colour: tuple[int, int, int]) -> Lines:
    arms_m = _NODE_RADIUS_M * np.eye(3)
    return Lines(np.stack([centre_m - arms_m, centre_m + arms_m], axis=1), colour)


def _fields_of_view(story: RunStory) -> Iterator[Drawing]:
    colours = distinct_colours(story.lidars)
    for lidar in sorted(story.clouds):
        strips = shown_field_of_view(story, lidar)
        if strips:
            segments_m = np.concatenate([segments_along(strip) for strip in strips])
            yield Drawing(lidar, lidar, (Lines(segments_m, colours[lidar]),))


def _uncertainty(story: RunStory, result: CalibrationResult) -> Iterator[Drawing]:
    colours = distinct_colours(story.lidars)
    for place in result.placements:
        found = uncertainty_ellipsoid(place)
        if found is not None:
            half_sizes_m, axes = found
            shown = Ellipsoid(axes, SHOWN_ELLIPSOID_SCALE * half_sizes_m, colours[place.lidar])
            yield Drawing(place.lidar, result.target, ellipsoids=(shown,))
