# SPDX-License-Identifier: Apache-2.0
"""Difference of two runs as JSON."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from multilica.results.document.values import Entry, Number, Vector3
from multilica.runs.difference import Move, PlacedByNeither, RunDifference, StatusChange
from multilica.runs.first_difference import Change

__all__ = ["DifferenceDocument", "difference_document"]


class MoveEntry(Entry):
    """A LiDAR that both runs place; second run - first run, along the axes of the first run's target."""

    moved: bool
    distance_m: float
    angle_deg: float
    translation_m: Vector3
    rotation_deg: Vector3
    sigmas: Number


class DifferenceDocument(Entry):
    """The output of `multilica diff --json`; null stands for what is not known."""

    schema_: Literal["multilica/difference/1"] = Field("multilica/difference/1", alias="schema")
    runs: tuple[str, str]
    same: bool
    target: str
    targets: tuple[str, str]
    moves: Mapping[str, MoveEntry]
    placed_by_neither: Mapping[str, PlacedByNeither]
    statuses: Mapping[str, StatusChange]
    first_difference: str | None
    differences: Mapping[str, tuple[Change, ...]]
    notes: tuple[str, ...]


def difference_document(difference: RunDifference) -> DifferenceDocument:
    """Convert a difference to its JSON document."""
    return DifferenceDocument(
        runs=difference.names,
        same=difference.same,
        target=difference.target,
        targets=difference.targets,
        moves={move.lidar: _move(move) for move in difference.moves},
        placed_by_neither={each.lidar: each for each in difference.neither},
        statuses={change.lidar: change for change in difference.statuses},
        first_difference=difference.partings[0].step if difference.partings else None,
        differences={parting.step: parting.changes for parting in difference.partings},
        notes=difference.notes,
    )


def _move(move: Move) -> MoveEntry:
    return MoveEntry(
        moved=move.moved,
        distance_m=move.error.distance_m,
        angle_deg=move.error.angle_deg,
        translation_m=move.error.translation_m,
        rotation_deg=np.rad2deg(move.error.rotation_rad),
        sigmas=move.sigmas,
    )
