# SPDX-License-Identifier: Apache-2.0
"""Contents of a report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairKey, PairRegistration, Registration
from multilica.results.document import ResultDocument
from multilica.results.prior_comparison import surprises
from multilica.sinks.drawing.shapes import sample_points
from multilica.sinks.files.result_document import run_document
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans

_RAW_SAMPLE = 60_000


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPoints:
    """Points of a pair at one pose, labelled by what the beams of the other LiDAR prove.

    Args:
        points_m: (N, 3) of the source, in its own frame.
        labels: (N,) `BeamLabel` of these.
        target_points_m, target_labels: the same of the target.
        agree, violate, occluded: number of points of both with that label, also if fewer points are at hand.
        evidence: of the pose.
    """

    T_target_source: RigidTransform
    points_m: FloatArray
    labels: npt.NDArray[np.uint8]
    target_points_m: FloatArray
    target_labels: npt.NDArray[np.uint8]
    agree: int
    violate: int
    occluded: int
    evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """Everything that a report shows of a run.

    Args:
        document: see `multilica.sinks.files.result_document`.
        clouds: per LiDAR its preprocessed cloud (N, 3) in its own frame.
        scored: per registered pair its best pose, then the competing one, if any.
        notes: remarks of the reader of the input, and on poses far from their prior.
        ended_early: why the run ended without a result; "" if it finished.
        level: pose of the target in a frame with z up; None without a ground plane.
    """

    document: ResultDocument
    clouds: Mapping[str, FloatArray]
    scored: Mapping[PairKey, tuple[ScoredPoints, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    ended_early: str = ""
    level: RigidTransform | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the LiDARs in order."""
        return tuple(self.document.lidars)

    @property
    def target(self) -> str:
        """Return the target LiDAR; the first LiDAR until the target is chosen."""
        return self.document.target or self.names[0]

    def poses(self) -> dict[str, RigidTransform]:
        """Return ``T_target_source`` of each placed or uncertain LiDAR, including the target."""
        return self.document.poses

    def is_uncertain(self, lidar: str) -> bool:
        """Return whether the LiDAR's standard deviation is above the limit."""
        return self.document.lidars[lidar].status == "uncertain"


def contents_of(state: RunState, ended_early: str = "") -> ReportContents:
    """Collect the contents of the report of a calibration that has started.

    Args:
        ended_early: why there is no result.
    """
    document = run_document(state)
    if state.snapshot is None or document is None:
        raise ValueError("there is nothing to report before a calibration has started")
    return ReportContents(
        document=document,
        clouds={lidar.name: _cloud(state, lidar) for lidar in state.snapshot.lidars},
        scored={(pair.target, pair.source): _scored(state, pair) for pair in state.registrations.values()},
        notes=(*state.snapshot.notes, *(() if state.result is None else surprises(state.result))),
        ended_early=ended_early,
        level=None if state.result is None else state.result.level,
    )


def _cloud(state: RunState, lidar: LidarScans) -> FloatArray:
    """Return the preprocessed cloud; without one, a sample of the raw returns."""
    if lidar.name in state.clouds:
        return state.clouds[lidar.name].points_m
    return sample_points(lidar.points_m, _RAW_SAMPLE).astype(np.float64)


def _scored(state: RunState, pair: PairRegistration) -> tuple[ScoredPoints, ...]:
    shown = (*pair.registrations[:1], state.competing(state.pair_of(pair)))
    return tuple(_scored_points(one) for one in shown if one is not None)


def _scored_points(one: Registration) -> ScoredPoints:
    beams = one.visibility
    return ScoredPoints(
        one.T_target_source,
        one.probes_m,
        beams.labels,
        one.target_probes_m,
        beams.target_labels,
        beams.agree,
        beams.violate,
        beams.occluded,
        one.evidence,
    )
