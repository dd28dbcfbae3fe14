# SPDX-License-Identifier: Apache-2.0
"""Results of the stages, each a frozen type."""

from multilica.results.calibration import (
    LEVEL_FRAME,
    CalibrationResult,
    Refusal,
    SnapshotDeviation,
    SnapshotReport,
    Status,
    TimeLimit,
)
from multilica.results.clouds import FeatureCloud, PreprocessedCloud, SensorHealth, SurfaceMatches, SurfaceResiduals
from multilica.results.hypotheses import (
    PRIOR,
    BoolArray,
    CoarseResult,
    Correspondences,
    Hypothesis,
    IndexArray,
    PairKey,
    hypothesis_label,
    pose_name,
)
from multilica.results.merging import Group, MergeCandidate, MergeDecision, PairResidual, Refinement
from multilica.results.placements import (
    ContestedPlace,
    GroundPlane,
    LidarPlacement,
    PlacementStatus,
    PoseConflict,
    SigmaOrigin,
    Spread,
)
from multilica.results.registrations import (
    GicpStep,
    PairRegistration,
    Reason,
    Registration,
    Stability,
    Verdict,
    connected,
)
from multilica.results.visibility_score import BeamLabel, VisibilityScore

__all__ = [
    "LEVEL_FRAME",
    "PRIOR",
    "BeamLabel",
    "BoolArray",
    "CalibrationResult",
    "CoarseResult",
    "ContestedPlace",
    "Correspondences",
    "FeatureCloud",
    "GicpStep",
    "GroundPlane",
    "Group",
    "Hypothesis",
    "IndexArray",
    "LidarPlacement",
    "MergeCandidate",
    "MergeDecision",
    "PairKey",
    "PairRegistration",
    "PairResidual",
    "PlacementStatus",
    "PoseConflict",
    "PreprocessedCloud",
    "Reason",
    "Refinement",
    "Refusal",
    "Registration",
    "SensorHealth",
    "SigmaOrigin",
    "SnapshotDeviation",
    "SnapshotReport",
    "Spread",
    "Stability",
    "Status",
    "SurfaceMatches",
    "SurfaceResiduals",
    "TimeLimit",
    "Verdict",
    "VisibilityScore",
    "connected",
    "hypothesis_label",
    "pose_name",
]
