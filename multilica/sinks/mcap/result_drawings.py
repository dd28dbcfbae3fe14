# SPDX-License-Identifier: Apache-2.0
"""Drawings of a result by topic."""

from collections.abc import Iterator, Mapping

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import CalibrationResult
from multilica.sinks.drawing.ellipsoid import SHOWN_ELLIPSOID_SCALE, uncertainty_ellipsoid
from multilica.sinks.drawing.field_of_view import shown_field_of_view
from multilica.sinks.drawing.matches import kept_matches, match_lines
from multilica.sinks.drawing.palette import KEPT, REJECTED, VERDICT_COLOURS, VIOLATE, distinct_colours
from multilica.sinks.drawing.primitives import EDGE_LABEL_SHARE, Drawing, Ellipsoid, Label, Lines, segments_along
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label

__all__ = ["DRAWING_TOPICS", "result_drawings"]

DRAWING_TOPICS = ("/matches", "/merge_graph", "/fields_of_view", "/uncertainty")

_MAX_MATCHES = 500
_WAITING_HEIGHT_M = 1.5
_NODE_RADIUS_M = 0.06


def result_drawings(state: RunState, result: CalibrationResult) -> Mapping[str, tuple[Drawing, ...]]:
    """Return the drawings of each topic of `DRAWING_TOPICS`."""
    drawings = (_matches(state), _merge_graph(state, result), _fields_of_view(state), _uncertainty(state, result))
    return {topic: tuple(found) for topic, found in zip(DRAWING_TOPICS, drawings, strict=True)}


def _matches(state: RunState) -> Iterator[Drawing]:
    """Draw a sample of each pair's matches at its best pose: kept ones are short, rejected ones long."""
    for pair, matches in sorted(state.matches.items()):
        coarse, found = state.coarse.get(pair), state.registrations.get(pair)
        if coarse is None or not coarse.hypotheses:
            continue
        index = max(found.hypothesis, 0) if found is not None else 0
        hypothesis = coarse.hypotheses[index]
        pose = found.T_target_source.with_target(pair[0]) if found is not None else hypothesis.T_target_source
        kept = kept_matches(state, matches, hypothesis)
        lines = (
            Lines(match_lines(matches, kept, pose, _MAX_MATCHES), KEPT),
            Lines(match_lines(matches, ~kept, pose, _MAX_MATCHES), REJECTED),
        )
        yield Drawing(pair_label(*pair), matches.target, lines)


def _merge_graph(state: RunState, result: CalibrationResult) -> Iterator[Drawing]:
    """Draw a node per LiDAR and an edge per registered pair with its fitness and verdict."""
    places_m = _places_m(result)
    colours = distinct_colours(state.lidars)
    for place in result.placements:
        text = place.lidar if place.placed else f"{place.lidar}: not placed"
        colour = colours[place.lidar] if place.placed else VIOLATE
        label = Label(places_m[place.lidar] + np.array([0.0, 0.0, 2.0 * _NODE_RADIUS_M]), text, colour)
        yield Drawing(place.lidar, result.target, labels=(label,), lines=(_cross(places_m[place.lidar], colour),))
    for pair, found in sorted(state.registrations.items()):
        start_m, end_m = places_m[pair[0]], places_m[pair[1]]
        colour = VERDICT_COLOURS[found.verdict.outcome]
        text = f"{found.fitness:.2f} {found.verdict.outcome}"
        label = Label(start_m + EDGE_LABEL_SHARE * (end_m - start_m), text, colour)
        edge = Lines(np.stack([start_m, end_m])[None], colour)
        yield Drawing(pair_label(*pair), result.target, (edge,), labels=(label,))


def _places_m(result: CalibrationResult) -> dict[str, FloatArray]:
    """Return positions of the LiDARs in the target's frame; unplaced ones are above it."""
    places_m = {place.lidar: place.T_target_source.xyz_m for place in result.placements if place.T_target_source}
    waiting = [place.lidar for place in result.placements if place.lidar not in places_m]
    above_m = {name: np.array([0.0, 0.0, _WAITING_HEIGHT_M * (1 + row)]) for row, name in enumerate(waiting)}
    return {**places_m, **above_m}


def _cross(centre_m: FloatArray, colour: tuple[int, int, int]) -> Lines:
    arms_m = _NODE_RADIUS_M * np.eye(3)
    return Lines(np.stack([centre_m - arms_m, centre_m + arms_m], axis=1), colour)


def _fields_of_view(state: RunState) -> Iterator[Drawing]:
    colours = distinct_colours(state.lidars)
    for lidar in sorted(state.clouds):
        strips = shown_field_of_view(state, lidar)
        if strips:
            segments_m = np.concatenate([segments_along(strip) for strip in strips])
            yield Drawing(lidar, lidar, (Lines(segments_m, colours[lidar]),))


def _uncertainty(state: RunState, result: CalibrationResult) -> Iterator[Drawing]:
    colours = distinct_colours(state.lidars)
    for place in result.placements:
        found = uncertainty_ellipsoid(place)
        if found is not None:
            half_sizes_m, axes = found
            shown = Ellipsoid(axes, SHOWN_ELLIPSOID_SCALE * half_sizes_m, colours[place.lidar])
            yield Drawing(place.lidar, result.target, ellipsoids=(shown,))
