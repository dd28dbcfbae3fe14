# SPDX-License-Identifier: Apache-2.0
"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairKey, PairRegistration
from multilica.sinks.rival_pose import rival_of
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory
from multilica.sinks.thinning import sample_points
from multilica.snapshot import LidarScans

__all__ = ["JudgedPoints", "ReportContents", "contents_of"]

_RAW_SAMPLE = 60_000


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPoints:
    """Points of a pair's source at one pose, with what the target's beams say of each.

    Args:
        points_m: (N, 3) in the source's frame.
        labels: (N,) `BeamLabel`.
    """

    T_target_source: RigidTransform
    points_m: FloatArray
    labels: npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """A run as its report shows it.

    Args:
        document: what `result.json` holds, or would hold; see `multilica.sinks.run_document`.
        clouds: per LiDAR its cleaned cloud (N, 3) in its own frame; empty where it has no returns.
        judged: per pair as it was registered, the pose that was chosen, then the other one where two are as good.
        notes: what the reader of the input noticed.
        ended_early: why the run ended before its result; "" if it finished.
    """

    document: Mapping[str, Any]
    clouds: Mapping[str, FloatArray]
    judged: Mapping[PairKey, tuple[JudgedPoints, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    ended_early: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """LiDARs in order."""
        return tuple(self.document["lidars"])

    @property
    def target(self) -> str:
        """The LiDAR that the others are placed relative to; the first one until it is chosen."""
        return str(self.document["target"] or self.names[0])

    def placed_poses(self) -> dict[str, RigidTransform]:
        """``T_target_source`` of each LiDAR that is placed, the target among them."""
        entries = self.document["lidars"].items()
        return {
            name: RigidTransform(self.target, name, np.asarray(entry["T_target_source"], dtype=np.float64))
            for name, entry in entries
            if entry["placed"]
        }


def contents_of(story: RunStory, ended_early: str = "") -> ReportContents:
    """The report of what is known so far.

    Args:
        story: of a calibration that has started.
        ended_early: why no result will come.
    """
    document = run_document(story)
    if story.snapshot is None or document is None:
        raise ValueError("there is nothing to report before a calibration has started")
    return ReportContents(
        document=document,
        clouds={lidar.name: _cloud(story, lidar) for lidar in story.snapshot.lidars},
        judged={(pair.target, pair.source): _judged(story, pair) for pair in story.registrations.values()},
        notes=story.snapshot.notes,
        ended_early=ended_early,
    )


def _cloud(story: RunStory, lidar: LidarScans) -> FloatArray:
    """The cleaned cloud; of a run that ended before there was one, a sample of the raw returns."""
    if lidar.name in story.clouds:
        return story.clouds[lidar.name].points_m
    return sample_points(lidar.points_m, _RAW_SAMPLE).astype(np.float64)


def _judged(story: RunStory, pair: PairRegistration) -> tuple[JudgedPoints, ...]:
    shown = (*pair.assessments[:1], rival_of(story, pair))
    return tuple(
        JudgedPoints(one.T_target_source, one.probes_m, one.testimony.labels) for one in shown if one is not None
    )
