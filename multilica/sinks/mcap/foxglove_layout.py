# SPDX-License-Identifier: Apache-2.0
"""Foxglove layout of a result.mcap."""

import json
from collections.abc import Mapping
from typing import Any

from multilica.sinks.drawing.palette import distinct_colours, hex_colour
from multilica.sinks.mcap.result_drawings import DRAWING_TOPICS

__all__ = ["foxglove_layout"]

_SCENE, _LOG, _METRICS = "3D!multilica", "RosOut!multilica", "RawMessages!multilica"
_GRID = "#ffffff20"
_AT_FIRST = {"/matches": False}
"""Hidden at first: hundreds of lines."""


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
            # Where none is named, the panel picks one and colours by it.
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
