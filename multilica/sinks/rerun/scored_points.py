# SPDX-License-Identifier: Apache-2.0
"""Points of a pair, labelled by what the other LiDAR's beams prove."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import FloatArray
from multilica.results import BeamLabel, PairKey, Registration
from multilica.sinks.drawing.palette import AGREE, OCCLUDED, UNSEEN, VIOLATE
from multilica.sinks.drawing.thinning import sample_indices
from multilica.sinks.rerun.scene import RerunScene
from multilica.sinks.rerun.tree import PAIRS, lidar_frame, pair_frame, pair_path

__all__ = ["log_beam_labels", "log_scored_points"]

_COLOURS = {
    BeamLabel.UNSEEN: UNSEEN,
    BeamLabel.AGREE: AGREE,
    BeamLabel.VIOLATE: VIOLATE,
    BeamLabel.OCCLUDED: OCCLUDED,
}


def log_beam_labels(scene: RerunScene) -> None:
    """Log the classes of scored points: two bytes a point instead of a colour each."""
    classes = [
        rr.AnnotationInfo(id=int(label), label=label.name.lower(), color=colour) for label, colour in _COLOURS.items()
    ]
    scene.stream.log(PAIRS, rr.AnnotationContext(classes), static=True)


def log_scored_points(scene: RerunScene, pair: PairKey, start: str, scored: Registration) -> None:
    """Log the scored points of both sides by label; repeat those in proven-empty space, larger.

    Args:
        start: the pose in whose frame the source's points are.
    """
    pose = scored.T_target_source.with_target(pair[0])
    violations_m: list[FloatArray] = []
    for side in _sides(pair, start, scored):
        _log_side(scene, pair, side)
        points_m = side.probes_m[side.labels == BeamLabel.VIOLATE]
        violations_m.append(pose.apply(points_m) if side.role == "source" else points_m)
    points = np.concatenate(violations_m).astype(np.float32)
    shown = rr.Points3D(points, colors=[VIOLATE], radii=rr.Radius.ui_points(4.0))
    scene.log(pair_path(*pair, "scored", "violations"), rr.CoordinateFrame(lidar_frame(pair[0])), shown)


@dataclass(frozen=True, slots=True, eq=False)
class _PairSide:
    """Scored points (N, 3) of one LiDAR of a pair in its own frame, with labels (N,)."""

    role: str
    frame: str
    probes_m: FloatArray
    labels: npt.NDArray[np.uint8]


def _sides(pair: PairKey, start: str, scored: Registration) -> Iterator[_PairSide]:
    """Return both sides as the pair was matched, in either order of the registration."""
    first = _PairSide("source", pair_frame(*pair, start), scored.probes_m, scored.visibility.labels)
    frame, visibility = lidar_frame(pair[0]), scored.visibility
    other = _PairSide("target", frame, scored.target_probes_m, visibility.target_labels)
    if scored.T_target_source.target != pair[0]:
        first, other = (
            _PairSide("source", first.frame, other.probes_m, other.labels),
            _PairSide("target", other.frame, first.probes_m, first.labels),
        )
    yield first
    yield other


def _log_side(scene: RerunScene, pair: PairKey, side: _PairSide) -> None:
    """Log the points with their first labels; for later poses only new labels, and for the source a new frame."""
    path = pair_path(*pair, "scored", side.role)
    rows = sample_indices(len(side.probes_m), scene.limits.scored_points)
    labels = side.labels[rows].astype(np.uint16)
    frame = rr.CoordinateFrame(side.frame)
    if path in scene.shown:
        scene.log(path, frame, rr.Points3D.from_fields(class_ids=labels))
        return
    scene.shown.add(path)
    points_m = side.probes_m[rows].astype(np.float32)
    scene.log(path, frame, rr.Points3D(points_m, class_ids=labels, radii=rr.Radius.ui_points(2.5)))
