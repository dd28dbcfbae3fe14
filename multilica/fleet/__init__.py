# SPDX-License-Identifier: Apache-2.0
"""Many runs as one table."""

from __future__ import annotations

from multilica.fleet.evaluation import Evaluation, Tolerances, Truth, evaluate
from multilica.fleet.runs import SavedPlacement, SavedRun, read_run

__all__ = ["Evaluation", "SavedPlacement", "SavedRun", "Tolerances", "Truth", "evaluate", "read_run"]
