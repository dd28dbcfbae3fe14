# SPDX-License-Identifier: Apache-2.0
"""Checks of a rig against reference extrinsics, for pipelines."""

from multilica.checks.comparison import CheckVerdict, LidarCheck, RigCheck, check_rig, joint_verdict
from multilica.checks.tolerances import Tolerance, Tolerances, read_tolerances

__all__ = [
    "CheckVerdict",
    "LidarCheck",
    "RigCheck",
    "Tolerance",
    "Tolerances",
    "check_rig",
    "joint_verdict",
    "read_tolerances",
]
