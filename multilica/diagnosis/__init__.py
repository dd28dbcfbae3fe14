# SPDX-License-Identifier: Apache-2.0
"""Explanations of a run in sentences for people."""

from multilica.diagnosis.explain import explain
from multilica.diagnosis.explanation import Cause, DecisivePair, Explanation, Missing, Placed, Uncertain

__all__ = ["Cause", "DecisivePair", "Explanation", "Missing", "Placed", "Uncertain", "explain"]
