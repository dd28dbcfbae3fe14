# SPDX-License-Identifier: Apache-2.0
"""Checks of a rig against reference extrinsics, for pipelines."""

from multilica.checks.absent import absent_lidars, with_absent
from multilica.checks.comparison import (
    LidarCheck,
    RigCheck,
    check_document,
    check_rig,
    relative_covariance,
)
from multilica.checks.known_poses import check_found, decide_unplaced, verify_snapshot
from multilica.checks.reference import (
    accept_run,
    poses_of,
    read_reference,
    require_known_lidars,
    require_reference,
)
from multilica.checks.stops import settle_stops, verify_stops, without_common_view
from multilica.checks.tolerances import RigTolerances, Tolerance, read_tolerances

__all__ = [
    "LidarCheck",
    "RigCheck",
    "RigTolerances",
    "Tolerance",
    "absent_lidars",
    "accept_run",
    "check_document",
    "check_found",
    "check_rig",
    "decide_unplaced",
    "poses_of",
    "read_reference",
    "read_tolerances",
    "relative_covariance",
    "require_known_lidars",
    "require_reference",
    "settle_stops",
    "verify_snapshot",
    "verify_stops",
    "with_absent",
    "without_common_view",
]
