# SPDX-License-Identifier: Apache-2.0
"""The result document as pydantic models."""

from multilica.results.document.lidars import ContestedEntry, HealthEntry, LidarEntry, PriorEntry, SpreadEntry
from multilica.results.document.merging import (
    CandidateEntry,
    CycleErrorEntry,
    DecisionEntry,
    RefinementEntry,
    ResidualEntry,
)
from multilica.results.document.pairs import PairEntry, ReasonEntry, RegistrationEntry, VerdictEntry
from multilica.results.document.result import RESULT_SCHEMA, ResultDocument, parse_result
from multilica.results.document.run import (
    DeviationEntry,
    GroundEntry,
    InputEntry,
    InputLidarEntry,
    ProgressEntry,
    RefusalEntry,
    SnapshotEntry,
)

__all__ = [
    "RESULT_SCHEMA",
    "CandidateEntry",
    "ContestedEntry",
    "CycleErrorEntry",
    "DecisionEntry",
    "DeviationEntry",
    "GroundEntry",
    "HealthEntry",
    "InputEntry",
    "InputLidarEntry",
    "LidarEntry",
    "PairEntry",
    "PriorEntry",
    "ProgressEntry",
    "ReasonEntry",
    "RefinementEntry",
    "RefusalEntry",
    "RegistrationEntry",
    "ResidualEntry",
    "ResultDocument",
    "SnapshotEntry",
    "SpreadEntry",
    "VerdictEntry",
    "parse_result",
]
