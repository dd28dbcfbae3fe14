# SPDX-License-Identifier: Apache-2.0
"""Explanations of a run in sentences for people."""

from multilica.diagnosis.explain import explain
from multilica.diagnosis.explanation import CAUSES, DecisivePair, Explanation, Missing, Placed, Uncertain

__all__ = ["CAUSES", "DecisivePair", "Explanation", "Missing", "Placed", "Uncertain", "explain"]
