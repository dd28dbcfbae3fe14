# SPDX-License-Identifier: Apache-2.0
"""Contents of a report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from multilica.diagnosis import Explanation, explain
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LEVEL_FRAME, PairKey, PairRegistration, Registration
from multilica.results.document import PairEntry, ResultDocument
from multilica.sinks.drawing import Rgb, distinct_colours, sample_returns
from multilica.sinks.run_state import RunState

SAME_POSE = 1e-4
"""Metres and radians: a recording holds poses in single precision."""
_RAW_SAMPLE = 60_000
_BADGES: Mapping[str, str] = {"unfinished": "ended early", "stopped_early": "stopped"}


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPoints:
    """Points of a pair at one pose, labelled by what the beams of the other LiDAR prove; none if they are not known.

    Args:
        points_m: (N, 3) of the source, in its own frame.
        labels: (N,) `BeamLabel` of these.
        target_points_m, target_labels: the same of the target.
        agree, violate, occluded: number of points of both with that label, also if fewer points are at hand.
        evidence: of the pose.
    """

    T_target_source: RigidTransform
    points_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    labels: npt.NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    target_points_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    target_labels: npt.NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    agree: int = 0
    violate: int = 0
    occluded: int = 0
    evidence: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """Everything that a report shows of a run: its document, and clouds from the running calibration or its recording.

    Args:
        clouds: per LiDAR its preprocessed cloud (N, 3) in its own frame.
        scored: per registered pair its best pose, then the competing one, if any.
        level: pose of the target in a frame with z up; None without a ground plane.
        ended_early: why the run ended without a result; "" if it finished.
    """

    document: ResultDocument
    clouds: Mapping[str, FloatArray]
    scored: Mapping[PairKey, tuple[ScoredPoints, ...]] = field(default_factory=dict)
    level: RigidTransform | None = None
    ended_early: str = ""

    @property
    def target(self) -> str:
        """Return the target LiDAR; the first LiDAR until the target is chosen."""
        return self.document.target or next(iter(self.document.lidars))

    @property
    def shown_level(self) -> RigidTransform:
        """Pose of the target in the frame of the pictures, which has the target's axes where no level is known."""
        return self.level or RigidTransform.identity(LEVEL_FRAME, self.target)

    @property
    def colours(self) -> dict[str, Rgb]:
        """Colour per LiDAR."""
        return distinct_colours(self.document.lidars)

    @property
    def explanation(self) -> Explanation:
        """Return the outcome in sentences."""
        return explain(self.document)

    @property
    def badge(self) -> str:
        """Return ``complete``, ``partial``, ``failed``, ``refused``, ``stopped`` or ``ended early``."""
        if (cause := self.explanation.cause) is not None:
            return _BADGES.get(cause, "refused")
        return _BADGES["unfinished"] if self.ended_early else self.document.status

    @property
    def details(self) -> tuple[str, ...]:
        """Return sentences below the headline: the target of a result, and why the run ended early."""
        reason = self.document.target_reason.rstrip(".")
        of_target = len(self.document.poses) > 1 and self.explanation.cause is None
        return (
            *((f"Target: {self.target} ({reason}).",) if of_target else ()),
            *((self.ended_early,) if self.ended_early else ()),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Return remarks of the reader of the input, and on poses far from their prior."""
        priors = (lidar.prior for lidar in self.document.lidars.values())
        return (*self.document.input.notes, *(prior.surprise for prior in priors if prior and prior.surprise))


def finalists(pair: PairEntry) -> list[RigidTransform]:
    """Return the poses that the pair's own search scored last, by evidence."""
    return [RigidTransform(*pair.key, np.asarray(one.T_target_source)) for one in pair.registrations]


def contents_of(state: RunState, ended_early: str = "") -> ReportContents:
    """Collect the contents of the report of a calibration that has started, with the reason if there is no result."""
    lidars = state.snapshot.lidars if state.snapshot is not None else ()
    return ReportContents(
        state.document,
        clouds={
            lidar.name: state.clouds[lidar.name].points_m
            if lidar.name in state.clouds
            else sample_returns(lidar, _RAW_SAMPLE).astype(np.float64)
            for lidar in lidars
        },
        scored={(pair.target, pair.source): _scored(state, pair) for pair in state.registrations.values()},
        level=None if state.result is None else state.result.level,
        ended_early=ended_early,
    )


def _scored(state: RunState, pair: PairRegistration) -> tuple[ScoredPoints, ...]:
    shown = (*pair.registrations[:1], state.competing(state.pair_of(pair)))
    return tuple(_scored_points(one) for one in shown if one is not None)


def _scored_points(one: Registration) -> ScoredPoints:
    beams = one.visibility
    points = (one.probes_m, beams.labels, one.target_probes_m, beams.target_labels)
    counts = (beams.agree, beams.violate, beams.occluded)
    return ScoredPoints(one.T_target_source, *points, *counts, one.evidence)
