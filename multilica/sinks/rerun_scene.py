# SPDX-License-Identifier: Apache-2.0
"""The recording stream with its clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import RigidTransform
from multilica.results import Assessment, Hypothesis
from multilica.sinks.narration import LogLine
from multilica.sinks.palette import Rgb, distinct_colours
from multilica.sinks.record_limits import NO_LIMITS, RecordLimits
from multilica.sinks.rerun_tree import LOG
from multilica.sinks.run_story import RunStory
from multilica.sinks.thinning import sample_points

__all__ = ["ITERATION_TIMELINE", "STEP_TIMELINE", "Scene", "rigid"]

STEP_TIMELINE = "step"
ITERATION_TIMELINE = "iteration"

_POINT_RADIUS_PIXELS = 1.25


@dataclass(slots=True, eq=False)
class Scene:
    """What the event handlers log to.

    Everything is logged on both timelines, at iteration 0 unless it is a moment of GICP: what is missing on a
    timeline cannot be seen there.

    Args:
        story: what happened so far, the current event included.
        limits: how much is logged; known once the calibration has started.
        step: the current moment on the step timeline.
        shown: paths of the clouds that were logged; from then on they are only moved or labelled anew.
        shown_at: per hypothesis, and per judgement of one, the step at which it is seen.
    """

    stream: rr.RecordingStream
    story: RunStory
    limits: RecordLimits = NO_LIMITS
    step: int = -1
    shown: set[str] = field(default_factory=set)
    shown_at: dict[Hypothesis | Assessment, int] = field(default_factory=dict)

    def advance(self, steps: int = 1) -> None:
        """Go on by a step, or by more to leave room for curves."""
        self.step += steps
        self.stream.set_time(STEP_TIMELINE, sequence=self.step)
        self.stream.set_time(ITERATION_TIMELINE, sequence=0)

    def log(self, path: str, *parts: rr.AsComponents) -> None:
        """Log at the current step."""
        self.stream.log(path, *parts)

    def log_curve(self, path: str, steps: Sequence[int], iterations: Sequence[int], values: Sequence[float]) -> None:
        """A value per step, which is an iteration on the other timeline: in columns, without a row's overhead."""
        times = [
            rr.TimeColumn(STEP_TIMELINE, sequence=steps),
            rr.TimeColumn(ITERATION_TIMELINE, sequence=iterations),
        ]
        if values:
            self.stream.send_columns(path, times, rr.Scalars.columns(scalars=values))

    def log_line(self, line: LogLine) -> None:
        """Add a line to the log."""
        self.log(LOG, rr.TextLog(line.text, level=line.level))

    def log_points(
        self,
        path: str,
        frame: str,
        points_m: npt.NDArray[np.floating],
        colour: Rgb,
        limit: int,
        *,
        radius_pixels: float = _POINT_RADIUS_PIXELS,
    ) -> None:
        """At most `limit` points of a cloud (N, 3) in that frame, in one colour: 12 bytes a point."""
        if limit == 0:
            return
        self.shown.add(path)
        shown = sample_points(points_m, limit)
        points = rr.Points3D(shown, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
        self.log(path, rr.CoordinateFrame(frame), points)

    def log_document(self, path: str, text: str) -> None:
        """A page of markdown."""
        self.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def colour(self, lidar: str) -> Rgb:
        """The colour of a LiDAR wherever it is shown."""
        return distinct_colours(self.story.lidars)[lidar]


def rigid(child_frame: str, parent_frame: str, pose: RigidTransform | None = None) -> rr.Transform3D:
    """Where a named frame sits in another one; without a pose they coincide.

    Translation and rotation are always both given: what a later log leaves out would keep its earlier value.
    """
    pose = pose if pose is not None else RigidTransform.identity(parent_frame, child_frame)
    return rr.Transform3D(
        translation=pose.xyz_m,
        quaternion=rr.Quaternion(xyzw=pose.quaternion_xyzw),
        child_frame=child_frame,
        parent_frame=parent_frame,
    )
