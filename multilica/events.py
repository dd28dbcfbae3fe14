# SPDX-License-Identifier: Apache-2.0
"""What happens during a calibration, for those who watch it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from multilica.config import CalibrationConfig, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import (
    Assessment,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GroundPlane,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Refinement,
)
from multilica.snapshot import Snapshot

__all__ = [
    "CalibrationFinished",
    "CalibrationStarted",
    "CloudPreprocessed",
    "CorrespondencesMatched",
    "Event",
    "FeaturesComputed",
    "GroundEstimated",
    "HypothesesAssessed",
    "HypothesesFound",
    "MergeStepTaken",
    "Observer",
    "PairRegistered",
    "RigRefined",
    "SearchWidened",
    "StageFinished",
    "StageStarted",
    "TargetChosen",
    "ignore",
]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationStarted:
    """The snapshot was read and the work begins.

    Args:
        prior: poses that are claimed beforehand, by the LiDARs' names.
    """

    snapshot: Snapshot
    config: CalibrationConfig
    prior: Extrinsics | None = None


@dataclass(frozen=True, slots=True)
class StageStarted:
    """A stage begins; `steps` is the number of events of this stage to come, 0 if unknown."""

    stage: Stage
    steps: int


@dataclass(frozen=True, slots=True)
class StageFinished:
    """A stage is over: the moment at which sinks write to disk."""

    stage: Stage
    elapsed_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CloudPreprocessed:
    """A LiDAR's cloud was cleaned."""

    cloud: PreprocessedCloud


@dataclass(frozen=True, slots=True, eq=False)
class FeaturesComputed:
    """A LiDAR's descriptors are there."""

    features: FeatureCloud


@dataclass(frozen=True, slots=True, eq=False)
class CorrespondencesMatched:
    """A pair's descriptors were matched."""

    correspondences: Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesFound:
    """A pair's coarse poses are there."""

    coarse: CoarseResult
    correspondences: Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesAssessed:
    """A pair's hypotheses were judged by visibility; the most believable first, only distinct ones."""

    target: str
    source: str
    assessments: tuple[Assessment, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SearchWidened:
    """Pairs of LiDARs that nothing links yet are searched again; those that are then accepted are told anew."""

    pairs: tuple[PairKey, ...]
    voxel_size_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PairRegistered:
    """GICP finished on a pair, or during merging on two groups, and the verdict is known."""

    registration: PairRegistration


@dataclass(frozen=True, slots=True)
class TargetChosen:
    """The root of the result is known."""

    target: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class MergeStepTaken:
    """Algorithm 1 took a turn.

    Args:
        poses: per member of the group that grew, its pose in the group's root frame; empty when the algorithm stopped.
    """

    decision: MergeDecision
    poses: tuple[RigidTransform, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RigRefined:
    """All poses were adjusted to all accepted pairs.

    Args:
        poses: per placed LiDAR, its pose in the target's frame.
    """

    refinement: Refinement
    poses: tuple[RigidTransform, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GroundEstimated:
    """The ground plane was fitted, or `ground` is None and `reason` says why not."""

    ground: GroundPlane | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFinished:
    """The outcome is known; that of a snapshot that is not fit says so, and `calibrate` raises after it."""

    result: CalibrationResult


Event = (
    CalibrationStarted
    | StageStarted
    | StageFinished
    | CloudPreprocessed
    | FeaturesComputed
    | CorrespondencesMatched
    | HypothesesFound
    | HypothesesAssessed
    | SearchWidened
    | PairRegistered
    | TargetChosen
    | MergeStepTaken
    | RigRefined
    | GroundEstimated
    | CalibrationFinished
)
Observer = Callable[[Event], None]


def ignore(event: Event) -> None:
    """The observer that nobody needs to pass."""
    del event
