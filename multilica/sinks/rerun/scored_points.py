# SPDX-License-Identifier: Apache-2.0
"""Points of a pair, labelled by what the other LiDAR's beams prove."""

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import FloatArray
from multilica.results import BeamLabel, PairKey, Registration
from multilica.sinks.drawing.clouds import sample_indices
from multilica.sinks.drawing.palette import AGREE, OCCLUDED, UNSEEN, VIOLATE
from multilica.sinks.rerun.entity_paths import PAIRS, lidar_frame, pair_frame, pair_path
from multilica.sinks.rerun.scene import RerunScene

_COLOURS = {
    BeamLabel.UNSEEN: UNSEEN,
    BeamLabel.AGREE: AGREE,
    BeamLabel.VIOLATE: VIOLATE,
    BeamLabel.OCCLUDED: OCCLUDED,
}


def _log_beam_labels(scene: RerunScene) -> None:
    """Log the classes of scored points, once: two bytes a point instead of a colour each."""
    if PAIRS in scene.shown:
        return
    scene.shown.add(PAIRS)
    classes = [
        rr.AnnotationInfo(id=int(label), label=label.name.lower(), color=colour) for label, colour in _COLOURS.items()
    ]
    scene.stream.log(PAIRS, rr.AnnotationContext(classes), static=True)


def log_scored_points(scene: RerunScene, pair: PairKey, start: str, scored: Registration) -> None:
    """Log the scored points of both sides by label; repeat those in proven-empty space, larger.

    Args:
        pair: as it was matched; the registration may be in either order.
        start: the pose in whose frame the source's points are.
    """
    _log_beam_labels(scene)
    source = (scored.probes_m, scored.visibility.labels)
    target = (scored.target_probes_m, scored.visibility.target_labels)
    if scored.T_target_source.target != pair[0]:
        source, target = target, source
    _log_side(scene, pair_path(*pair, "scored", "source"), pair_frame(*pair, start), *source)
    _log_side(scene, pair_path(*pair, "scored", "target"), lidar_frame(pair[0]), *target)
    violations_m, target_violations_m = (points_m[labels == BeamLabel.VIOLATE] for points_m, labels in (source, target))
    moved_m = scored.T_target_source.with_target(pair[0]).apply(violations_m)
    points = np.concatenate([moved_m, target_violations_m]).astype(np.float32)
    shown = rr.Points3D(points, colors=[VIOLATE], radii=rr.Radius.ui_points(4.0))
    scene.log_in(lidar_frame(pair[0]), pair_path(*pair, "scored", "violations"), shown)


def _log_side(scene: RerunScene, path: str, frame: str, points_m: FloatArray, labels: npt.NDArray[np.uint8]) -> None:
    """Log the points with their first labels; for later poses only new labels, and for the source a new frame."""
    rows = sample_indices(len(points_m), scene.limits.scored_points)
    classes = labels[rows].astype(np.uint16)
    if path in scene.shown:
        scene.log_in(frame, path, rr.Points3D.from_fields(class_ids=classes))
        return
    shown = rr.Points3D(points_m[rows].astype(np.float32), class_ids=classes, radii=rr.Radius.ui_points(2.5))
    scene.log_in(frame, path, shown)
