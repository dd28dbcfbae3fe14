# SPDX-License-Identifier: Apache-2.0
"""Checks of a rig against reference extrinsics, for pipelines."""

from multilica.checks.accept_run import accept_run
from multilica.checks.check_document import CheckDocument, check_document
from multilica.checks.comparison import (
    CheckVerdict,
    LidarCheck,
    RigCheck,
    check_rig,
    joint_verdict,
    relative_covariance,
)
from multilica.checks.reference import poses_of, read_reference
from multilica.checks.tolerances import RigTolerances, Tolerance, read_tolerances
from multilica.checks.verify_snapshot import check_found, decide_unplaced, verify_snapshot

__all__ = [
    "CheckDocument",
    "CheckVerdict",
    "LidarCheck",
    "RigCheck",
    "RigTolerances",
    "Tolerance",
    "accept_run",
    "check_document",
    "check_found",
    "check_rig",
    "decide_unplaced",
    "joint_verdict",
    "poses_of",
    "read_reference",
    "read_tolerances",
    "relative_covariance",
    "verify_snapshot",
]
