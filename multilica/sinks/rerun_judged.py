# SPDX-License-Identifier: Apache-2.0
"""What the beams of both LiDARs of a pair say of each other's points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import FloatArray
from multilica.results import Assessment, PairKey
from multilica.sinks.palette import AGREE, OCCLUDED, UNSEEN, VIOLATE
from multilica.sinks.rerun_scene import Scene
from multilica.sinks.rerun_tree import PAIRS, hypothesis_frame, lidar_frame, pair_path
from multilica.sinks.run_story import as_matched
from multilica.sinks.thinning import sample_indices
from multilica.stages.beam_image import BeamLabel

__all__ = ["log_beam_labels", "log_judged"]

_COLOURS = {
    BeamLabel.UNSEEN: UNSEEN,
    BeamLabel.AGREE: AGREE,
    BeamLabel.VIOLATE: VIOLATE,
    BeamLabel.OCCLUDED: OCCLUDED,
}


def log_beam_labels(scene: Scene) -> None:
    """The meaning of the classes of judged points: two bytes a point instead of a colour each."""
    classes = [
        rr.AnnotationInfo(id=int(label), label=label.name.lower(), color=colour) for label, colour in _COLOURS.items()
    ]
    scene.stream.log(PAIRS, rr.AnnotationContext(classes), static=True)


def log_judged(scene: Scene, pair: PairKey, start: str, assessment: Assessment) -> None:
    """Judged points of both sides by verdict, those in empty space once more and larger.

    Args:
        start: the pose on trial, whose frame the source's points hang in.
    """
    pose = as_matched(pair, assessment.T_target_source)
    violations_m: list[FloatArray] = []
    for side in _sides(pair, start, assessment):
        _log_side(scene, pair, side)
        points_m = side.probes_m[side.labels == BeamLabel.VIOLATE]
        violations_m.append(pose.apply(points_m) if side.role == "source" else points_m)
    points = np.concatenate(violations_m).astype(np.float32)
    shown = rr.Points3D(points, colors=[VIOLATE], radii=rr.Radius.ui_points(4.0))
    scene.log(pair_path(*pair, "judged", "violations"), rr.CoordinateFrame(lidar_frame(pair[0])), shown)


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """The judged points (N, 3) of one LiDAR of a pair in its own frame, with their labels (N,)."""

    role: str
    frame: str
    probes_m: FloatArray
    labels: npt.NDArray[np.uint8]


def _sides(pair: PairKey, start: str, assessment: Assessment) -> Iterator[_Side]:
    """As the pair was matched, whichever way round it was registered."""
    first = _Side("source", hypothesis_frame(*pair, start), assessment.probes_m, assessment.testimony.labels)
    frame, testimony = lidar_frame(pair[0]), assessment.testimony
    other = _Side("target", frame, assessment.target_probes_m, testimony.target_labels)
    if assessment.T_target_source.target != pair[0]:
        first, other = (
            _Side("source", first.frame, other.probes_m, other.labels),
            _Side("target", other.frame, first.probes_m, first.labels),
        )
    yield first
    yield other


def _log_side(scene: Scene, pair: PairKey, side: _Side) -> None:
    """The points are logged with their first labels; later poses bring new labels, and for the source a new frame."""
    path = pair_path(*pair, "judged", side.role)
    rows = sample_indices(len(side.probes_m), scene.limits.judged_points)
    labels = side.labels[rows].astype(np.uint16)
    frame = rr.CoordinateFrame(side.frame)
    if path in scene.shown:
        scene.log(path, frame, rr.Points3D.from_fields(class_ids=labels))
        return
    scene.shown.add(path)
    points_m = side.probes_m[rows].astype(np.float32)
    scene.log(path, frame, rr.Points3D(points_m, class_ids=labels, radii=rr.Radius.ui_points(2.5)))
