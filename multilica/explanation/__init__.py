# SPDX-License-Identifier: Apache-2.0
"""A run's result in sentences for people."""

from __future__ import annotations

from multilica.explanation.explain import explain
from multilica.explanation.explanation import Cause, Comparison, Explanation, Missing, Placed

__all__ = ["Cause", "Comparison", "Explanation", "Missing", "Placed", "explain"]
