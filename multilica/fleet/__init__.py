# SPDX-License-Identifier: Apache-2.0
"""Many runs as one table."""

from __future__ import annotations

from multilica.fleet.evaluation import Evaluation, Tolerances, Truth, evaluate
from multilica.fleet.pose_error import PoseError, as_sigma, normalised_error
from multilica.fleet.runs import SavedPlacement, SavedRun, read_run

__all__ = [
    "Evaluation",
    "PoseError",
    "SavedPlacement",
    "SavedRun",
    "Tolerances",
    "Truth",
    "as_sigma",
    "evaluate",
    "normalised_error",
    "read_run",
]
