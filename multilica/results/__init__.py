# SPDX-License-Identifier: Apache-2.0
"""What each stage finds: one frozen type per stage."""

from __future__ import annotations

from multilica.results.calibration import CalibrationResult, Status
from multilica.results.clouds import FeatureCloud, PreprocessedCloud, SensorHealth
from multilica.results.hypotheses import (
    PRIOR,
    BoolArray,
    CoarseResult,
    Correspondences,
    Hypothesis,
    IndexArray,
    PairKey,
    hypothesis_label,
)
from multilica.results.merging import EdgeResidual, MergeCandidate, MergeDecision, Refinement
from multilica.results.placements import GroundPlane, LidarPlacement, SigmaOrigin, Spread
from multilica.results.reason import Reason
from multilica.results.registrations import Assessment, FineStep, Hold, PairRegistration, Verdict
from multilica.results.snapshots import Refusal, SnapshotDeviation, SnapshotReport

__all__ = [
    "PRIOR",
    "Assessment",
    "BoolArray",
    "CalibrationResult",
    "CoarseResult",
    "Correspondences",
    "EdgeResidual",
    "FeatureCloud",
    "FineStep",
    "GroundPlane",
    "Hold",
    "Hypothesis",
    "IndexArray",
    "LidarPlacement",
    "MergeCandidate",
    "MergeDecision",
    "PairKey",
    "PairRegistration",
    "PreprocessedCloud",
    "Reason",
    "Refinement",
    "Refusal",
    "SensorHealth",
    "SigmaOrigin",
    "SnapshotDeviation",
    "SnapshotReport",
    "Spread",
    "Status",
    "Verdict",
    "hypothesis_label",
]
