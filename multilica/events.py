# SPDX-License-Identifier: Apache-2.0
"""Events of a calibration."""

from collections.abc import Callable
from dataclasses import dataclass

from multilica.config import CalibrationConfig, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import (
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
    Registration,
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
    "GroupsRegistered",
    "HypothesesFound",
    "HypothesesVerified",
    "InputNoted",
    "LoopRegistered",
    "MergeStepTaken",
    "Observer",
    "PairRegistered",
    "RigRefined",
    "RunEvent",
    "RunObserver",
    "SearchWidened",
    "SnapshotRefused",
    "SnapshotStarted",
    "StageFinished",
    "StageStarted",
    "TargetChosen",
    "VerdictChanged",
    "ignore",
]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationStarted:
    """The snapshot was read and the calibration starts.

    Args:
        prior: poses that the user claims, by the LiDARs' names.
    """

    snapshot: Snapshot
    config: CalibrationConfig
    prior: Extrinsics | None = None


@dataclass(frozen=True, slots=True)
class StageStarted:
    """A stage starts; `steps` is the number of its events to come, 0 if unknown."""

    stage: Stage
    steps: int


@dataclass(frozen=True, slots=True)
class StageFinished:
    """A stage finished; sinks write to disk now."""

    stage: Stage
    elapsed_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CloudPreprocessed:
    """A LiDAR's cloud was cleaned."""

    cloud: PreprocessedCloud


@dataclass(frozen=True, slots=True, eq=False)
class FeaturesComputed:
    """A LiDAR's descriptors were computed."""

    features: FeatureCloud


@dataclass(frozen=True, slots=True, eq=False)
class CorrespondencesMatched:
    """A pair's descriptors were matched."""

    correspondences: Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesFound:
    """A pair's hypotheses were found."""

    coarse: CoarseResult
    correspondences: Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesVerified:
    """A pair's hypotheses were scored by visibility; only distinct ones, the one with the most evidence first."""

    target: str
    source: str
    registrations: tuple[Registration, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SearchWidened:
    """Pairs that no accepted pair connects are searched again; events follow for those that are then accepted."""

    pairs: tuple[PairKey, ...]
    voxel_size_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PairRegistered:
    """A pair of LiDARs was registered by GICP and has a verdict."""

    registration: PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class VerdictChanged:
    """Other pairs cast doubt on a registered pair: its verdict is no longer ``accept``."""

    registration: PairRegistration


@dataclass(frozen=True, slots=True)
class TargetChosen:
    """The root of the result was chosen."""

    target: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class GroupsRegistered:
    """Two groups of placed LiDARs were registered during merging and have a verdict."""

    registration: PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class MergeStepTaken:
    """Algorithm 1 took a step.

    Args:
        poses: per member of the group that grew, its pose in the group's root frame; empty when the algorithm stopped.
    """

    decision: MergeDecision
    poses: tuple[RigidTransform, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LoopRegistered:
    """Two placed LiDARs were registered from the pose that the rig implies; ignored unless it is accepted."""

    registration: PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class RigRefined:
    """All poses were refined jointly.

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
    """The calibration ended; for a refused snapshot, `calibrate` raises an error after it."""

    result: CalibrationResult


Event = (
    CalibrationStarted
    | StageStarted
    | StageFinished
    | CloudPreprocessed
    | FeaturesComputed
    | CorrespondencesMatched
    | HypothesesFound
    | HypothesesVerified
    | SearchWidened
    | PairRegistered
    | VerdictChanged
    | TargetChosen
    | GroupsRegistered
    | MergeStepTaken
    | LoopRegistered
    | RigRefined
    | GroundEstimated
    | CalibrationFinished
)
Observer = Callable[[Event], None]


@dataclass(frozen=True, slots=True)
class SnapshotStarted:
    """The next of several snapshots is read and calibrated by itself."""

    name: str


@dataclass(frozen=True, slots=True)
class InputNoted:
    """A sentence about the recording or the prior that the user should know."""

    note: str


@dataclass(frozen=True, slots=True)
class SnapshotRefused:
    """One of several snapshots cannot be used; the others are calibrated without it."""

    name: str
    reason: str


RunEvent = Event | SnapshotStarted | InputNoted | SnapshotRefused
"""What `run_calibration` reports: the events of each calibration, and those of reading its input."""
RunObserver = Callable[[RunEvent], None]


def ignore(event: RunEvent) -> None:
    """Observe nothing."""
    del event
