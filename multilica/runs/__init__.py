# SPDX-License-Identifier: Apache-2.0
"""Saved runs: reading, evaluation, comparison."""

from multilica.runs.evaluation import Evaluation, Tolerances, Truth, evaluate
from multilica.runs.pose_error import PoseError, as_sigma, normalised_error
from multilica.runs.saved_run import SavedPlacement, SavedRun, read_run

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
