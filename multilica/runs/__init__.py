# SPDX-License-Identifier: Apache-2.0
"""Saved runs: reading, evaluation, comparison."""

from multilica.runs.evaluation import Evaluation, Tolerances, Truth, evaluate
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import SavedRun, read_run

__all__ = ["Evaluation", "PoseError", "SavedRun", "Tolerances", "Truth", "evaluate", "read_run"]
