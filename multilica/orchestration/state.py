# SPDX-License-Identifier: Apache-2.0
"""Results of the stages so far."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from multilica.config import CalibrationConfig
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.orchestration.pairs import PreparedLidar
from multilica.results import (
    CoarseResult,
    GroundPlane,
    Group,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Reason,
    Refinement,
    Registration,
    SensorHealth,
    TimeLimit,
)
from multilica.snapshot import Snapshot
from multilica.stages.slow_motion import SlowMotion
from multilica.visibility.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.visibility.sensor_view import FINE_TOLERANCES, ROUGH_TOLERANCES, SensorView, score_pose
from multilica.workers import Workers

_Scores = dict[tuple[str, str, bytes], Registration]
"""By the names of target and source and the bits of the pose."""


def deadline_of(config: CalibrationConfig) -> float:
    """Return the end of `runtime.max_time_s` from now, on `time.monotonic`; infinite without a limit."""
    return time.monotonic() + config.runtime.max_time_s if config.runtime.max_time_s else float("inf")


@dataclass(slots=True)
class CalibrationState:
    """Results of the stages so far.

    Args:
        searched: the pairs as their search ended; in `registrations`, those that other pairs imply replace them.
        implied_by: of pairs that others imply, the LiDARs of each of these.
    """

    snapshot: Snapshot
    config: CalibrationConfig
    observe: Observer
    prior: Extrinsics | None = None
    workers: Workers = field(default_factory=Workers)
    health: list[SensorHealth] = field(default_factory=list)
    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    slow_motion: SlowMotion = field(default_factory=SlowMotion)
    lidars: dict[str, PreparedLidar] = field(default_factory=dict)
    coarse: dict[PairKey, CoarseResult] = field(default_factory=dict)
    verified: dict[PairKey, tuple[Registration, ...]] = field(default_factory=dict)
    registrations: dict[PairKey, PairRegistration] = field(default_factory=dict)
    searched: dict[PairKey, PairRegistration] = field(default_factory=dict)
    implied_by: dict[PairKey, list[frozenset[str]]] = field(default_factory=dict)
    scores: _Scores = field(default_factory=dict)
    rough_scores: _Scores = field(default_factory=dict)
    tested_loops: set[PairKey] = field(default_factory=set)
    target: str = ""
    target_reason: str = ""
    decisions: list[MergeDecision] = field(default_factory=list)
    sides: dict[tuple[str, ...], RegistrationCloud] = field(default_factory=dict)
    merged_lidars: dict[tuple[str, ...], PreparedLidar] = field(default_factory=dict)
    group: Group | None = None
    merges: list[tuple[PairRegistration, ...]] = field(default_factory=list)
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)
    repeatability: Mapping[str, FloatArray] = field(default_factory=dict)
    refinement: Refinement | None = None
    doubts: Mapping[str, str] = field(default_factory=dict)
    level: RigidTransform | None = None
    held: Mapping[str, Reason] = field(default_factory=dict)
    fixed_pairs: Mapping[PairKey, PairRegistration] = field(default_factory=dict)
    rig: Extrinsics | None = None
    earlier: EarlierStops = field(default_factory=EarlierStops)
    ground: GroundPlane | None = None
    ground_refusal: str = ""
    deadline_s: float = float("inf")
    cut_short: bool = False
    not_reached: tuple[PairKey, ...] = ()
    timing_s: dict[str, float] = field(default_factory=dict)

    @property
    def pairs(self) -> list[PairKey]:
        """All pairs of LiDARs with returns, in name order."""
        return list(combinations(self.clouds, 2))

    @property
    def out_of_time(self) -> bool:
        """True if the time of the whole calibration is over."""
        return time.monotonic() > self.deadline_s

    @property
    def time_limit(self) -> TimeLimit | None:
        """Searches left out because the time was over; None if nothing was."""
        return TimeLimit(self.config.runtime.max_time_s, self.not_reached) if self.cut_short else None

    @property
    def accepted(self) -> list[PairRegistration]:
        """The accepted pairs, in name order."""
        ordered = (self.registrations[pair] for pair in sorted(self.registrations))
        return [pair for pair in ordered if pair.verdict.accepted]

    @property
    def poses(self) -> Mapping[str, RigidTransform]:
        """``T_target_lidar`` of the target's group; empty before it exists."""
        return {} if self.group is None else self.group.poses

    def score_pose(self, pose: RigidTransform) -> Registration:
        """Score a pose between any two LiDARs by their beams."""
        return self._scored(pose, self.scores, FINE_TOLERANCES)

    def remember(self, scores: Iterable[Registration]) -> None:
        """Keep scores for `score_pose`."""
        for scored in scores:
            pose = scored.T_target_source
            self.scores[pose.target, pose.source, pose.matrix.tobytes()] = scored

    def score_rough_pose(self, pose: RigidTransform) -> Registration:
        """Score a pose that may be off by some centimetres."""
        return self._scored(pose, self.rough_scores, ROUGH_TOLERANCES)

    def points_of(self, poses: Mapping[str, RigidTransform]) -> FloatArray:
        """Return the points (N, 3) of LiDARs at their poses."""
        return np.concatenate([pose.apply(self.clouds[name].points_m) for name, pose in sorted(poses.items())])

    def side_of(self, root: str, poses: Mapping[str, RigidTransform]) -> RegistrationCloud:
        """Prepare the root, or several LiDARs in its frame, for registration."""
        if len(poses) == 1:
            return self.lidars[root].side
        views = [(pose, view) for name, pose in sorted(poses.items()) if (view := self.lidars[name].view) is not None]
        elevation_axis = self.clouds[root].elevation_axis
        return prepare_registration_cloud(root, self.points_of(poses), views, self.config, elevation_axis)

    def _scored(self, pose: RigidTransform, known: _Scores, tolerances: tuple[float, float]) -> Registration:
        key = pose.target, pose.source, pose.matrix.tobytes()
        if key not in known:
            known[key] = score_pose(self._view(pose.target), self._view(pose.source), pose, *tolerances)
        return known[key]

    def _view(self, name: str) -> SensorView:
        view = self.lidars[name].view
        assert view is not None  # noqa: S101 - verification is on
        return view
