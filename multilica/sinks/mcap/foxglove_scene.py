# SPDX-License-Identifier: Apache-2.0
"""Drawings as Foxglove scene entities."""

from collections.abc import Sequence

from foxglove.messages import (
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from multilica.sinks.drawing.palette import Rgb
from multilica.sinks.drawing.primitives import Drawing, Ellipsoid, Label, Lines

__all__ = ["scene_update"]

_LINE_PIXELS = 2.0
_TEXT_PIXELS = 14.0
_OPACITY = 0.6


def scene_update(drawings: Sequence[Drawing], timestamp: Timestamp) -> SceneUpdate:
    """Return an entity per drawing that follows its frame."""
    entities = [
        SceneEntity(
            timestamp=timestamp,
            frame_id=drawing.frame_id,
            id=drawing.name,
            frame_locked=True,
            lines=[_lines(lines) for lines in drawing.lines],
            spheres=[_sphere(ellipsoid) for ellipsoid in drawing.ellipsoids],
            texts=[_text(label) for label in drawing.labels],
        )
        for drawing in drawings
    ]
    return SceneUpdate(entities=entities)


def _lines(lines: Lines) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        pose=_pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        thickness=_LINE_PIXELS,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in lines.segments_m.reshape(-1, 3).tolist()],
        color=_color(lines.colour),
    )


def _sphere(ellipsoid: Ellipsoid) -> SpherePrimitive:
    x, y, z = (2.0 * ellipsoid.half_sizes_m).tolist()
    pose = _pose(ellipsoid.pose.xyz_m.tolist(), ellipsoid.pose.quaternion_xyzw.tolist())
    return SpherePrimitive(pose=pose, size=Vector3(x=x, y=y, z=z), color=_color(ellipsoid.colour, _OPACITY))


def _text(label: Label) -> TextPrimitive:
    return TextPrimitive(
        pose=_pose(label.xyz_m.tolist(), (0.0, 0.0, 0.0, 1.0)),
        billboard=True,
        font_size=_TEXT_PIXELS,
        scale_invariant=True,
        color=_color(label.colour),
        text=label.text,
    )


def _pose(xyz_m: Sequence[float], xyzw: Sequence[float]) -> Pose:
    x, y, z = xyz_m
    qx, qy, qz, qw = xyzw
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _color(colour: Rgb, opacity: float = 1.0) -> Color:
    red, green, blue = (channel / 255.0 for channel in colour)
    return Color(r=red, g=green, b=blue, a=opacity)
