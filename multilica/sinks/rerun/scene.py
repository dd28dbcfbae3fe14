# SPDX-License-Identifier: Apache-2.0
"""Recording stream with its timelines."""

import time
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.geometry import RigidTransform
from multilica.results import Hypothesis, Registration
from multilica.sinks.drawing.palette import Rgb, distinct_colours
from multilica.sinks.drawing.shapes import sample_points
from multilica.sinks.rerun.entity_paths import LOG
from multilica.sinks.rerun.record_limits import NO_LIMITS, RecordLimits
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine

STEP_TIMELINE = "step"
ITERATION_TIMELINE = "iteration"
CLOCK_TIMELINE = "log_time"

_POINT_RADIUS_PIXELS = 1.25


@dataclass(slots=True, eq=False)
class RerunScene:
    """The stream that event handlers log to.

    Everything is logged on both timelines, since entities missing on a timeline are invisible there. Iteration is 0
    except for GICP's progress.

    Args:
        state: after the current event.
        limits: set when the calibration starts.
        step: current position on the step timeline.
        started_ns: wall clock of the first event.
        shown: paths of the entities with a frame so far; later poses only move or relabel clouds.
        shown_at: per pose the step at which it is shown.
    """

    stream: rr.RecordingStream
    state: RunState
    limits: RecordLimits = NO_LIMITS
    step: int = -1
    started_ns: int = 0
    shown: set[str] = field(default_factory=set)
    shown_at: dict[Hypothesis | Registration, int] = field(default_factory=dict)

    def advance(self, steps: int = 1) -> None:
        """Advance by a step, or by more to leave room for curves."""
        if self.step < 0:
            self.started_ns = time.time_ns()
        self.step += steps
        self.stream.set_time(STEP_TIMELINE, sequence=self.step)
        self.stream.set_time(ITERATION_TIMELINE, sequence=0)

    def log(self, path: str, *parts: rr.AsComponents) -> None:
        """Log at the current step."""
        self.stream.log(path, *parts)

    def log_in(self, frame: str, path: str, *parts: rr.AsComponents) -> None:
        """Log at the current step in a frame that is known by then."""
        self.shown.add(path)
        self.log(path, rr.CoordinateFrame(frame), *parts)

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
        """Log at most `limit` points of a cloud (N, 3) in that frame, in one colour: 12 bytes a point."""
        if limit == 0:
            return
        shown = sample_points(points_m, limit)
        points = rr.Points3D(shown, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
        self.log_in(frame, path, points)

    def log_document(self, path: str, text: str) -> None:
        """Log markdown."""
        self.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def colour(self, lidar: str) -> Rgb:
        """Return the colour of a LiDAR in every view."""
        return distinct_colours(self.state.lidars)[lidar]

    def pair_colour(self, target: str, source: str) -> Rgb:
        """Return the colour of a pair in every plot."""
        names = sorted(self.state.lidars)
        pairs = [f"{first}/{second}" for first, second in combinations(range(len(names)), 2)]
        first, second = sorted((names.index(target), names.index(source)))
        return distinct_colours(pairs)[f"{first}/{second}"]


def rigid(child_frame: str, parent_frame: str, pose: RigidTransform | None = None) -> rr.Transform3D:
    """Return the transform of a frame in another one; without a pose they coincide.

    It always has translation and rotation: a later log that omits one would keep its earlier value.
    """
    pose = pose if pose is not None else RigidTransform.identity(parent_frame, child_frame)
    return rr.Transform3D(
        translation=pose.xyz_m,
        quaternion=rr.Quaternion(xyzw=pose.quaternion_xyzw),
        child_frame=child_frame,
        parent_frame=parent_frame,
    )
