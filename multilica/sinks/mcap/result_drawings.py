# SPDX-License-Identifier: Apache-2.0
"""Drawings of a result by topic, shown by a Foxglove layout."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from multilica.geometry import FloatArray
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.palette import (
    KEPT,
    REJECTED,
    UNCERTAIN,
    VERDICT_COLOURS,
    VIOLATE,
    distinct_colours,
    hex_colour,
)
from multilica.sinks.drawing.shapes import (
    EDGE_LABEL_SHARE,
    Drawing,
    Ellipsoid,
    Label,
    Lines,
    ellipsoid_label,
    ellipsoid_scale,
    kept_matches,
    match_lines,
    segments_along,
    shown_field_of_view,
    uncertainty_ellipsoid,
)
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label

DRAWING_TOPICS = ("/matches", "/merge_graph", "/fields_of_view", "/uncertainty")

_MAX_MATCHES = 500
_WAITING_HEIGHT_M = 1.5
_NODE_RADIUS_M = 0.06
_SCENE, _LOG, _METRICS = "3D!multilica", "RosOut!multilica", "RawMessages!multilica"
_GRID = "#ffffff20"
_AT_FIRST = {"/matches": False}
"""Hidden at first: hundreds of lines."""


def result_drawings(state: RunState, document: ResultDocument) -> Mapping[str, tuple[Drawing, ...]]:
    """Return the drawings of each topic of `DRAWING_TOPICS`."""
    frames = cloud_frames(document)
    drawings = (
        _matches(state, frames),
        _merge_graph(state, document),
        _fields_of_view(state, frames),
        _uncertainty(state, document),
    )
    return {topic: tuple(found) for topic, found in zip(DRAWING_TOPICS, drawings, strict=True)}


def cloud_frames(document: ResultDocument) -> dict[str, str]:
    """Return the frame of each LiDAR's cloud: its name, which no transform has for an uncertain LiDAR."""
    return {
        name: f"uncertain/{name}" if entry.status == "uncertain" else name for name, entry in document.lidars.items()
    }


def _matches(state: RunState, frames: Mapping[str, str]) -> Iterator[Drawing]:
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
        yield Drawing(pair_label(*pair), frames[matches.target], lines)


def _merge_graph(state: RunState, document: ResultDocument) -> Iterator[Drawing]:
    """Draw a node per LiDAR and an edge per registered pair with its fitness and verdict."""
    places_m, colours, poses = _places_m(document), distinct_colours(state.lidars), document.poses
    for name, entry in document.lidars.items():
        text = name if entry.placed else f"{name}: {entry.status.replace('_', ' ')}"
        colour = colours[name] if name in poses else VIOLATE
        label = Label(places_m[name] + np.array([0.0, 0.0, 2.0 * _NODE_RADIUS_M]), text, colour)
        yield Drawing(name, document.target, labels=(label,), lines=(_cross(places_m[name], colour),))
    for pair, found in sorted(state.registrations.items()):
        start_m, end_m = places_m[pair[0]], places_m[pair[1]]
        colour = VERDICT_COLOURS[found.verdict.outcome]
        text = f"{found.fitness:.2f} {found.verdict.outcome}"
        label = Label(start_m + EDGE_LABEL_SHARE * (end_m - start_m), text, colour)
        edge = Lines(np.stack([start_m, end_m])[None], colour)
        yield Drawing(pair_label(*pair), document.target, (edge,), labels=(label,))


def _places_m(document: ResultDocument) -> dict[str, FloatArray]:
    """Return positions of the LiDARs in the target's frame; unplaced ones are above it."""
    places_m = {name: pose.xyz_m for name, pose in document.poses.items()}
    waiting = [name for name in document.lidars if name not in places_m]
    above_m = {name: np.array([0.0, 0.0, _WAITING_HEIGHT_M * (1 + row)]) for row, name in enumerate(waiting)}
    return {**places_m, **above_m}


def _cross(centre_m: FloatArray, colour: tuple[int, int, int]) -> Lines:
    arms_m = _NODE_RADIUS_M * np.eye(3)
    return Lines(np.stack([centre_m - arms_m, centre_m + arms_m], axis=1), colour)


def _fields_of_view(state: RunState, frames: Mapping[str, str]) -> Iterator[Drawing]:
    colours = distinct_colours(state.lidars)
    for lidar in sorted(state.clouds):
        strips = shown_field_of_view(state, lidar)
        if strips:
            segments_m = np.concatenate([segments_along(strip) for strip in strips])
            yield Drawing(lidar, frames[lidar], (Lines(segments_m, colours[lidar]),))


def _uncertainty(state: RunState, document: ResultDocument) -> Iterator[Drawing]:
    colours, scale = distinct_colours(state.lidars), ellipsoid_scale(document)
    for lidar in document.lidars:
        found = uncertainty_ellipsoid(document, lidar)
        if found is not None:
            half_sizes_m, axes = found
            shown = Ellipsoid(axes, scale * half_sizes_m, colours[lidar])
            text = ellipsoid_label(document, lidar, scale)
            labels = (Label(axes.xyz_m, text, UNCERTAIN),) if text else ()
            yield Drawing(lidar, document.target, ellipsoids=(shown,), labels=labels)


def foxglove_layout(target: str, cloud_topics: Mapping[str, str]) -> str:
    """Return JSON for "Import from file": clouds and drawings in one scene, log and metrics beside it.

    Args:
        target: the LiDAR whose frame the scene follows.
        cloud_topics: of every LiDAR, in order.
    """
    layout = {
        "configById": {
            _SCENE: _scene(target, cloud_topics),
            _LOG: {"searchTerms": [], "minLogLevel": 1, "topicToRender": "/log"},
            _METRICS: {"topicPath": "/metrics", "diffEnabled": False},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _SCENE,
            "second": {"direction": "column", "first": _METRICS, "second": _LOG, "splitPercentage": 50},
            "splitPercentage": 70,
        },
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _scene(target: str, cloud_topics: Mapping[str, str]) -> dict[str, Any]:
    colours = distinct_colours(tuple(cloud_topics))
    clouds = {
        topic: {
            "visible": True,
            "colorMode": "flat",
            # If none is named, the panel picks one and colours by it.
            "colorField": "z",
            "flatColor": hex_colour(colours[name]),
            "pointSize": 2,
        }
        for name, topic in cloud_topics.items()
    }
    drawings = {topic: {"visible": _AT_FIRST.get(topic, True)} for topic in DRAWING_TOPICS}
    return {
        "followMode": "follow-pose",
        "followTf": target,
        "scene": {"transforms": {"showLabel": True, "axisScale": 0.5}},
        "cameraState": {"perspective": True, "distance": 30, "phi": 55, "thetaOffset": 45, "targetOffset": [0, 0, 0]},
        "topics": {**clouds, **drawings},
        "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "size": 40, "divisions": 40, "color": _GRID}},
    }
