# SPDX-License-Identifier: Apache-2.0
"""Events of a calibration."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from multilica import results
from multilica.config import CalibrationConfig, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.snapshot import Snapshot


class Event:
    """One thing that happens during `calibrate`."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationStarted(Event):
    """The snapshot was read and the calibration starts; `prior` has the poses that the user claims, by LiDAR.

    The `stops` of a joint result are those that links connect, in order.
    """

    snapshot: Snapshot
    config: CalibrationConfig
    prior: Extrinsics | None = None
    stops: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StageStarted(Event):
    """A stage starts; `steps` is the number of its events to come, 0 if unknown."""

    stage: Stage
    steps: int


@dataclass(frozen=True, slots=True)
class StageFinished(Event):
    """A stage finished; sinks write to disk now."""

    stage: Stage
    elapsed_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CloudPreprocessed(Event):
    """A LiDAR's cloud was cleaned."""

    cloud: results.PreprocessedCloud


@dataclass(frozen=True, slots=True, eq=False)
class FeaturesComputed(Event):
    """A LiDAR's descriptors were computed."""

    features: results.FeatureCloud


@dataclass(frozen=True, slots=True, eq=False)
class CorrespondencesMatched(Event):
    """A pair's descriptors were matched."""

    correspondences: results.Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesFound(Event):
    """A pair's hypotheses were found."""

    coarse: results.CoarseResult
    correspondences: results.Correspondences


@dataclass(frozen=True, slots=True, eq=False)
class HypothesesVerified(Event):
    """A pair's hypotheses were scored by visibility; only distinct ones, the one with the most evidence first."""

    target: str
    source: str
    registrations: tuple[results.Registration, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SearchWidened(Event):
    """Pairs that no accepted pair connects are searched again; events follow for those that are then accepted."""

    pairs: tuple[results.PairKey, ...]
    voxel_size_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PairRegistered(Event):
    """A pair of LiDARs was registered by GICP and has a verdict."""

    registration: results.PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class VerdictChanged(Event):
    """Other pairs cast doubt on a registered pair: its verdict is no longer ``accept``."""

    registration: results.PairRegistration


@dataclass(frozen=True, slots=True)
class TargetChosen(Event):
    """The root of the result was chosen."""

    target: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class GroupsRegistered(Event):
    """Two groups of placed LiDARs were registered during merging and have a verdict."""

    registration: results.PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class MergeStepTaken(Event):
    """Two groups were merged, or merging stopped; `poses` of the group that grew are in its root frame, else none."""

    decision: results.MergeDecision
    poses: tuple[RigidTransform, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LoopRegistered(Event):
    """Two LiDARs were registered from the pose that accepted pairs imply; ignored unless it is accepted."""

    registration: results.PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class MovableFound(Event):
    """Some of the `count` points of a LiDAR, `points_m` (N, 3), lie on objects that could have moved, or that `moved`.

    The latter are left out of the poses.
    """

    lidar: str
    points_m: FloatArray
    count: int
    moved: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RigRefined(Event):
    """All poses were refined jointly; `poses` of the placed LiDARs are in the target's frame."""

    refinement: results.Refinement
    poses: tuple[RigidTransform, ...]


@dataclass(frozen=True, slots=True, eq=False)
class StopsLinked(Event):
    """The vehicle's poses at the stops of a drive follow from links; `points_m` (N, 3) are those of each view."""

    stops: tuple[results.StopPose, ...]
    links: tuple[results.StopLink, ...]
    points_m: Mapping[results.DriveView, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class SurfacesMatched(Event):
    """The clouds of a registered pair were matched at its final pose."""

    matches: results.SurfaceMatches


@dataclass(frozen=True, slots=True, eq=False)
class ResidualsMeasured(Event):
    """The merged cloud was compared with one placed LiDAR."""

    residuals: results.SurfaceResiduals


@dataclass(frozen=True, slots=True, eq=False)
class GroundEstimated(Event):
    """The ground plane was fitted, or `ground` is None and `reason` says why not."""

    ground: results.GroundPlane | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFinished(Event):
    """The calibration ended; for a refused snapshot, `calibrate` raises an error after it."""

    result: results.CalibrationResult


Observer = Callable[[Event], None]


@dataclass(frozen=True, slots=True)
class SnapshotStarted:
    """The next of several snapshots is read and calibrated by itself."""

    name: str


@dataclass(frozen=True, slots=True)
class StopsProgressed:
    """So many of the samples in which the stops of a log are sought, or of the stops to read, are done."""

    doing: Literal["find stops", "read stops"]
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class InputNoted:
    """A sentence about the recording or the prior that the user should know."""

    note: str


@dataclass(frozen=True, slots=True)
class SnapshotRefused:
    """One of several snapshots cannot be used; the others are calibrated without it."""

    name: str
    reason: str


RunEvent = Event | SnapshotStarted | StopsProgressed | InputNoted | SnapshotRefused
"""Reports of `run_calibration`: the events of each calibration, and those of reading its input."""
RunObserver = Callable[[RunEvent], None]


def ignore(event: RunEvent) -> None:
    """Observe nothing."""
    del event
