# SPDX-License-Identifier: Apache-2.0
"""The recording stream with its clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import RigidTransform
from multilica.results import PairKey
from multilica.sinks.narration import LogLine
from multilica.sinks.palette import Rgb, distinct_colours
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
        max_cloud_points: larger clouds are thinned to so many points.
        step: the current moment on the step timeline.
        shown_sources: pairs whose source cloud was logged.
    """

    stream: rr.RecordingStream
    story: RunStory
    max_cloud_points: int
    step: int = -1
    shown_sources: set[PairKey] = field(default_factory=set)

    def advance(self, iteration: int = 0) -> None:
        """Go to the next step."""
        self.step += 1
        self.stream.set_time(STEP_TIMELINE, sequence=self.step)
        self.stream.set_time(ITERATION_TIMELINE, sequence=iteration)

    def log(self, path: str, *parts: rr.AsComponents) -> None:
        """Log at the current step."""
        self.stream.log(path, *parts)

    def log_line(self, line: LogLine) -> None:
        """Add a line to the log."""
        self.log(LOG, rr.TextLog(line.text, level=line.level))

    def log_points(
        self,
        path: str,
        frame: str,
        points_m: npt.NDArray[np.floating],
        colour: Rgb,
        *,
        limit: int | None = None,
        radius_pixels: float = _POINT_RADIUS_PIXELS,
    ) -> None:
        """A cloud (N, 3) in that frame, in one colour: 12 bytes a point."""
        shown = sample_points(points_m, min(limit or self.max_cloud_points, self.max_cloud_points))
        points = rr.Points3D(shown, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
        self.log(path, rr.CoordinateFrame(frame), points)

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
