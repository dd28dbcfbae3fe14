# SPDX-License-Identifier: Apache-2.0
"""Results of the stages so far."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

from multilica.config import CalibrationConfig
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import (
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GroundPlane,
    Group,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Refinement,
    Registration,
    SensorHealth,
)
from multilica.snapshot import Snapshot
from multilica.stages.fine import Side
from multilica.stages.verify import PreparedLidar
from multilica.visibility.sensor_view import score_pose

__all__ = ["CalibrationState"]


@dataclass(slots=True)
class CalibrationState:
    """Results of the stages so far."""

    snapshot: Snapshot
    config: CalibrationConfig
    observe: Observer
    prior: Extrinsics | None = None
    health: list[SensorHealth] = field(default_factory=list)
    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    features: dict[str, FeatureCloud] = field(default_factory=dict)
    matches: dict[PairKey, Correspondences] = field(default_factory=dict)
    coarse: dict[PairKey, CoarseResult] = field(default_factory=dict)
    prepared: dict[str, PreparedLidar] = field(default_factory=dict)
    verified: dict[PairKey, tuple[Registration, ...]] = field(default_factory=dict)
    sides: dict[str, Side] = field(default_factory=dict)
    registrations: dict[PairKey, PairRegistration] = field(default_factory=dict)
    doubted: set[PairKey] = field(default_factory=set)
    target: str = ""
    target_reason: str = ""
    decisions: list[MergeDecision] = field(default_factory=list)
    group: Group | None = None
    merges: list[PairRegistration] = field(default_factory=list)
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)
    refinement: Refinement | None = None
    ground: GroundPlane | None = None
    timing_s: dict[str, float] = field(default_factory=dict)

    @property
    def pairs(self) -> list[PairKey]:
        """All pairs of LiDARs with returns, in name order."""
        return list(combinations(self.clouds, 2))

    @property
    def poses(self) -> Mapping[str, RigidTransform]:
        """``T_target_lidar`` of the target's group; empty before it exists."""
        return {} if self.group is None else self.group.poses

    def score_pose(self, pose: RigidTransform) -> Registration:
        """Score a pose between any two LiDARs by their beams."""
        target, source = self.prepared[pose.target].view, self.prepared[pose.source].view
        return score_pose(target, source, pose, self.config.visibility)
