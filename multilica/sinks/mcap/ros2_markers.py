# SPDX-License-Identifier: Apache-2.0
"""Drawings as ROS 2 markers."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from multilica.sinks.drawing.palette import Rgb
from multilica.sinks.drawing.primitives import Drawing

__all__ = ["MARKER_ARRAY", "marker_array"]

MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"

_SPHERE, _LINE_LIST, _TEXT = 2, 5, 9
_LINE_WIDTH_M = 0.03
_TEXT_HEIGHT_M = 0.15
_OPACITY = 0.6


def marker_array(store: Typestore, drawings: Sequence[Drawing], stamp: Any) -> Any:  # noqa: ANN401 - made at run time
    """Return markers that follow their frames, a namespace per drawing.

    Args:
        stamp: a ``builtin_interfaces/msg/Time``.
    """
    markers = [
        _marker(store, drawing, stamp, index, parts)
        for drawing in drawings
        for index, parts in enumerate(_parts(store, drawing))
    ]
    return store.types[MARKER_ARRAY](markers=markers)


def _parts(store: Typestore, drawing: Drawing) -> Iterator[dict[str, Any]]:
    """Yield the fields that differ between the markers of a drawing."""
    types = store.types
    point = types["geometry_msgs/msg/Point"]
    for lines in drawing.lines:
        if len(lines.segments_m):
            points = [point(x=x, y=y, z=z) for x, y, z in lines.segments_m.reshape(-1, 3).tolist()]
            width = _vector(store, (_LINE_WIDTH_M, 0.0, 0.0))
            yield {"type": _LINE_LIST, "points": points, "scale": width, "color": _color(store, lines.colour)}
    for ellipsoid in drawing.ellipsoids:
        pose = _pose(store, ellipsoid.pose.xyz_m.tolist(), ellipsoid.pose.quaternion_xyzw.tolist())
        size = _vector(store, (2.0 * ellipsoid.half_sizes_m).tolist())
        yield {"type": _SPHERE, "pose": pose, "scale": size, "color": _color(store, ellipsoid.colour, _OPACITY)}
    for label in drawing.labels:
        pose, height = _pose(store, label.xyz_m.tolist()), _vector(store, (0.0, 0.0, _TEXT_HEIGHT_M))
        yield {"type": _TEXT, "pose": pose, "scale": height, "color": _color(store, label.colour), "text": label.text}


def _marker(store: Typestore, drawing: Drawing, stamp: Any, index: int, parts: dict[str, Any]) -> Any:  # noqa: ANN401
    types = store.types
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=drawing.frame_id)
    nothing = np.zeros(0, dtype=np.uint8)
    unused = {
        "action": 0,
        "pose": _pose(store, (0.0, 0.0, 0.0)),
        "lifetime": types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
        "frame_locked": True,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "texture": types["sensor_msgs/msg/CompressedImage"](header=header, format="", data=nothing),
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": types["visualization_msgs/msg/MeshFile"](filename="", data=nothing),
        "mesh_use_embedded_materials": False,
    }
    return types["visualization_msgs/msg/Marker"](header=header, ns=drawing.name, id=index, **{**unused, **parts})


def _pose(store: Typestore, xyz_m: Sequence[float], xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Any:  # noqa: ANN401
    types = store.types
    x, y, z = xyz_m
    qx, qy, qz, qw = xyzw
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )


def _vector(store: Typestore, xyz: Sequence[float]) -> Any:  # noqa: ANN401
    x, y, z = xyz
    return store.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _color(store: Typestore, colour: Rgb, opacity: float = 1.0) -> Any:  # noqa: ANN401
    red, green, blue = (channel / 255.0 for channel in colour)
    return store.types["std_msgs/msg/ColorRGBA"](r=red, g=green, b=blue, a=opacity)
