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
    LEVEL_FRAME,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    GroundPlane,
    Group,
    LidarPlacement,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Refinement,
    Refusal,
    Registration,
    SensorHealth,
)
from multilica.snapshot import Snapshot
from multilica.stages.fine import Side
from multilica.stages.ground import estimate_level
from multilica.stages.outcome import Findings, placement_of
from multilica.stages.refine import trusted_pairs
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

    def score_pose(self, pose: RigidTransform) -> Registration:
        """Score a pose between any two LiDARs by their beams."""
        target, source = self.prepared[pose.target].view, self.prepared[pose.source].view
        return score_pose(target, source, pose, self.config.visibility)

    def result(self) -> CalibrationResult:
        """Return the outcome as far as the stages went."""
        target = self.target or self.config.target or self.snapshot.names[0]
        findings = Findings(
            target=target,
            poses={} if self.group is None else self.group.poses,
            covariances=self.covariances,
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            with_returns=frozenset(self.clouds),
            until=self.config.until,
            prior=self.prior,
            score_pose=self.score_pose if self.prepared else None,
        )
        return CalibrationResult(
            target=target,
            target_reason=self.target_reason or "no pair was registered",
            placements=tuple(placement_of(name, findings) for name in self.snapshot.names),
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            refinement=self.refinement,
            ground=self.ground,
            trusted=tuple(trusted_pairs(self.registrations.values(), self.merges)),
            timing_s=dict(self.timing_s),
            health=tuple(self.health),
            level=self.level(target),
        )

    def level(self, target: str) -> RigidTransform | None:
        """Return the pose of the target in a frame with z up, from the ground plane or a quick estimate of it."""
        if self.ground is not None:
            return RigidTransform(LEVEL_FRAME, target, self.ground.T_base_target.matrix)
        clouds = {name: cloud.points_m for name, cloud in self.clouds.items()}
        return estimate_level(target, clouds, {} if self.group is None else self.group.poses, self.config)

    def refused(self, refusal: Refusal) -> CalibrationResult:
        """Return the outcome of a refused snapshot: no LiDAR is placed, not even the target."""
        return CalibrationResult(
            target=self.config.target or self.snapshot.names[0],
            target_reason="the snapshot was refused",
            placements=tuple(LidarPlacement(name, reason=refusal.text) for name in self.snapshot.names),
            timing_s=dict(self.timing_s),
            health=tuple(self.health),
            refusal=refusal,
        )
