# SPDX-License-Identifier: Apache-2.0
"""Recording stream with its entities, frames and timelines, and the limits on its size."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import rerun as rr

from multilica.config import RecordConfig
from multilica.geometry import RigidTransform
from multilica.results import Hypothesis, PairKey, Registration
from multilica.sinks.drawing import Rgb, distinct_colours, sample_points
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import LogLine
from multilica.snapshot import Snapshot

LOG, SUMMARY, CONFIG, RESULT, DROPPED_TABLE = "/log", "/summary", "/config", "/result", "/dropped"
PAIRS, PAIRS_TABLE, HYPOTHESES_TABLE = "/pairs", "/pair_figures", "/hypotheses"
FITNESS, COVERAGE, VERDICTS = "/fitness", "/coverage", "/verdicts"
MERGE_GRAPH, MERGE_STEPS = "/merge/graph", "/merge/steps"
PAIR_TABLE, MERGE_TABLE, TIMINGS = "/tables/pairs", "/tables/merge", "/timings"
GROUND, FRAMES = "/ground", "/frames"

DISPLAY_FRAME = "display"
ROOT_FRAME = "tf#/"
"""Rerun's own name for the frame of entities that no frame is logged for."""

CURVES = {
    "fitness": "fitness within GICP's distance",
    "error": "GICP cost",
    "translation_step_m": "translation per step, m",
    "rotation_step_rad": "rotation per step, rad",
}
"""Fields of `GicpStep` with the titles of their plots."""
_ALL = 10**9
_POINT_BYTES, _LINE_BYTES, _LABEL_BYTES, _MATCH_BYTES = 12, 24, 2, 80
_CLOUDS_OF_A_PAIR = 4
_SCORED_POSES = 20
_BYTES_OF_A_RUN, _BYTES_OF_A_PAIR = 2_000_000, 200_000
"""Poses, curves, tables, blueprints and the index of the file, whatever the number of points.

Measured without points: 3.0 MB with 4 LiDARs and 6 pairs, 12.4 MB with 20 LiDARs and 54 pairs.
"""
_LEAST_SHARE, _LATER_SHARE = 0.01, 0.1
# A search until accepted pairs link all LiDARs, and the loops that it tests, take 54 pairs of 20 LiDARs.
_PAIRS_PER_LIDAR = 3
STEP_TIMELINE = "step"
ITERATION_TIMELINE = "iteration"
CLOCK_TIMELINE = "log_time"
STOP_TIMELINE = "stop"
_POINT_RADIUS_PIXELS = 1.25


def lidar_path(lidar: str, *parts: str) -> str:
    """Return an entity path of one LiDAR."""
    return rr.new_entity_path(["lidars", lidar, *parts])


def pair_path(target: str, source: str, *parts: str) -> str:
    """Return an entity path of one pair."""
    return rr.new_entity_path(["pairs", target, source, *parts])


def curve_path(quantity: str, target: str = "", source: str = "", start: str = "") -> str:
    """Return the path of a GICP curve of a pair from a start; without a pair, the parent of all curves."""
    return rr.new_entity_path(["gicp", quantity, *(part for part in (target, source, start) if part)])


def lidar_frame(lidar: str) -> str:
    """Return the LiDAR's own frame."""
    return f"lidar/{lidar}"


def slot_frame(lidar: str) -> str:
    """Return the display-only frame of a LiDAR without a pose."""
    return f"slot/{lidar}"


def pair_frame(target: str, source: str, name: str) -> str:
    """Return a frame of a pair's source, named by its pose, or ``before``, ``competing`` or ``lifted``."""
    return f"pair/{target}/{source}/{name}"


def drive_path(first: str, *parts: str) -> str:
    """Return an entity path of the stops that links connect with the first one."""
    return rr.new_entity_path(["drive", first, *parts])


def stop_frame(stop: str, lidar: str = "") -> str:
    """Return the frame of the target LiDAR at a stop of a drive, or that of another LiDAR there."""
    return f"stop/{stop}/{lidar}" if lidar else f"stop/{stop}"


class RecordLimits(NamedTuple):
    """Maximum counts in a recording.

    Args:
        raw_points: per LiDAR, before anything is dropped.
        cloud_points: per LiDAR, of the preprocessed cloud, and of the dropped points of each reason.
        feature_points, normals: per LiDAR.
        pair_points: per pair, of each copy of the source's cloud.
        stop_points: per LiDAR and stop of a drive.
        scored_points: per pair and side.
        matches: per pair, of the kept and of the rejected ones, as lines.
        match_rows: per pair, of the matches as data, and of the matches of its surfaces.
    """

    raw_points: int
    cloud_points: int
    feature_points: int
    normals: int
    pair_points: int
    stop_points: int
    scored_points: int
    matches: int
    match_rows: int

    def times(self, share: float) -> RecordLimits:
        """Return a share of all counts."""
        return RecordLimits(*(int(share * limit) for limit in self))


class RecordPlan(NamedTuple):
    """Limits of a recording.

    Args:
        limits: that keep it below its budget.
        share: of the usual limits.
        pairs: number of pairs that are recorded with these limits; later ones get a tenth.
    """

    limits: RecordLimits
    share: float = 1.0
    pairs: int = _ALL


NO_LIMITS = RecordLimits(*[_ALL] * 9)
_NO_PLAN = RecordPlan(NO_LIMITS)
_LIMITS: Mapping[str, RecordLimits] = {
    "full": NO_LIMITS,
    "normal": RecordLimits(500_000, 500_000, 500_000, 1500, 30_000, 30_000, 6000, 1000, 2000),
    "slim": RecordLimits(0, 30_000, 0, 0, 5000, 5000, 2000, 200, 200),
}


def limits_for(config: RecordConfig, snapshot: Snapshot, stops: int = 0) -> RecordPlan:
    """Return the limits that keep the recording below its budget.

    Not all pairs of many LiDARs are searched: if all at the usual limits exceed the budget, later ones count a tenth.

    Args:
        stops: number of stops of a drive that are recorded.
    """
    limits = _LIMITS[config.detail]
    if config.detail == "full":
        return RecordPlan(limits)
    counts = [lidar.points_count for lidar in snapshot.lidars]
    pairs = len(counts) * (len(counts) - 1) // 2
    budget = config.max_megabytes * 1e6 - _BYTES_OF_A_RUN - pairs * _BYTES_OF_A_PAIR
    if budget >= _expected_bytes(limits, counts, stops, pairs):
        return RecordPlan(limits)
    planned = min(pairs, _PAIRS_PER_LIDAR * len(counts))
    expected = _expected_bytes(limits, counts, stops, planned + _LATER_SHARE * (pairs - planned))
    share = min(1.0, max(_LEAST_SHARE, budget / expected))
    return RecordPlan(limits.times(share), share, planned)


def _expected_bytes(limits: RecordLimits, counts: list[int], stops: int, pairs: float) -> float:
    """Return an upper bound of the size: thinning drops more, files are compressed."""
    per_lidar = sum(
        _POINT_BYTES * (min(limits.raw_points, count) + min(limits.cloud_points, count))
        + _POINT_BYTES * min(limits.feature_points, count)
        + _LINE_BYTES * min(limits.normals, count)
        + _POINT_BYTES * stops * min(limits.stop_points, count)
        for count in counts
    )
    largest = max(counts, default=0)
    per_pair = (
        _CLOUDS_OF_A_PAIR * _POINT_BYTES * min(limits.pair_points, largest)
        + 3 * _LINE_BYTES * limits.matches
        + _MATCH_BYTES * min(limits.match_rows, largest)
        + 2 * (_POINT_BYTES + _SCORED_POSES * _LABEL_BYTES) * min(limits.scored_points, largest)
    )
    return max(1.0, per_lidar + pairs * per_pair)


@dataclass(slots=True, eq=False)
class RerunScene:
    """The stream that event handlers log to.

    Everything is logged on all timelines, since entities missing on a timeline are invisible there. Iteration is 0
    except for GICP's progress, and the stop of a drive is 0 except for the clouds of a stop.

    Args:
        state: after the current event.
        file: that the stream writes.
        plan: set when the calibration starts.
        step: current position on the step timeline.
        started_ns: wall clock of the first event.
        shown: paths of the entities with a frame, or a style, so far; later poses only move or relabel clouds.
        shown_at: per pose the step at which it is shown.
        is_abandoned: True after a failed write; nothing can be logged any more.
    """

    stream: rr.RecordingStream
    state: RunState
    file: Path
    plan: RecordPlan = _NO_PLAN
    step: int = -1
    started_ns: int = 0
    shown: set[str] = field(default_factory=set)
    shown_at: dict[Hypothesis | Registration, int] = field(default_factory=dict)
    is_abandoned: bool = False
    _numbers: dict[frozenset[str], int] = field(default_factory=dict)

    @property
    def limits(self) -> RecordLimits:
        """The limits of what is not of a pair."""
        return self.plan.limits

    def limits_of(self, pair: PairKey) -> RecordLimits:
        """Return the limits of a pair, in either order: a tenth after as many pairs as planned."""
        number = self._numbers.setdefault(frozenset(pair), len(self._numbers))
        return self.limits if number < self.plan.pairs else self.limits.times(_LATER_SHARE)

    def advance(self, steps: int = 1) -> None:
        """Advance by a step, or by more to leave room for curves."""
        if self.step < 0:
            self.started_ns = time.time_ns()
        self.step += steps
        self.stream.set_time(STEP_TIMELINE, sequence=self.step)
        self.stream.set_time(ITERATION_TIMELINE, sequence=0)
        self.at_stop(0)

    def at_stop(self, number: int) -> None:
        """Log at that number of a stop until the next step; the timeline is only in recordings of a drive."""
        if self.state.stops:
            self.stream.set_time(STOP_TIMELINE, sequence=number)

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
