# SPDX-License-Identifier: Apache-2.0
"""Comparison of two runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from multilica.diagnosis import explain
from multilica.errors import InputError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray
from multilica.results.document import ResultDocument
from multilica.results.document.values import Entry, Number, Vector3
from multilica.runs.first_difference import Change, StageDifference, stage_differences
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import RunDocument

PlacementStatus = Literal["placed", "uncertain", "not placed", "missing"]


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A LiDAR of which both runs have a pose.

    Args:
        uncertain: whether one of the two poses is uncertain.
        error: second pose - first pose, along the axes of the first run's target.
        sigmas: the largest of the six differences divided by its standard deviation; None without covariances.
        moved: whether it moved by more than the limits.
    """

    lidar: str
    error: PoseError
    sigmas: float | None
    moved: bool
    uncertain: bool


class StatusChange(Entry):
    """A LiDAR whose status differs; with the cause from a run that did not place it."""

    lidar: str
    before: PlacementStatus
    after: PlacementStatus
    why: str


class PlacedByNeither(Entry):
    """A LiDAR that both runs have and neither placed; with the cause in each run."""

    lidar: str
    before: str
    after: str


@dataclass(frozen=True, slots=True, eq=False)
class RunDifference:
    """Differences between two runs.

    Args:
        target: LiDAR in whose axes the moves are.
        moves: per LiDAR of which both have a pose, in name order, without the target.
        statuses: per LiDAR that they do not agree on.
        neither: per LiDAR that none of them placed, in name order.
        stage_differences: steps at which the runs differ, in order.
        notes: what could not be compared.
    """

    names: tuple[str, str]
    target: str
    targets: tuple[str, str]
    moves: tuple[Move, ...]
    statuses: tuple[StatusChange, ...]
    neither: tuple[PlacedByNeither, ...]
    stage_differences: tuple[StageDifference, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """True if both place the same LiDARs at the same poses, within the limits."""
        return not self.statuses and not any(move.moved for move in self.moves)

    @property
    def places_nothing(self) -> bool:
        """True if neither run places a LiDAR, the target included."""
        return bool(self.neither) and self.target in {each.lidar for each in self.neither} and not self.statuses


class MoveEntry(Entry):
    """A LiDAR of which both runs have a pose; second run - first run, along the axes of the first run's target."""

    moved: bool
    uncertain: bool
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


def compare_runs(before: RunDocument, after: RunDocument, *, within_m: float, within_rad: float) -> RunDifference:
    """Compare the second run with the first.

    Args:
        within_m, within_rad: a LiDAR that differs by no more has not moved.

    Raises:
        InputError: the runs have no LiDAR in common.
    """
    first, second = before.document, after.document
    if not {*first.lidars} & {*second.lidars}:
        raise InputError(f"{before.path} and {after.path} have no LiDAR in common; give two runs of one rig.")
    rigs = Extrinsics(first.target, first.poses), Extrinsics(second.target, second.poses)
    common = {*first.poses} & {*second.poses}
    found = {name: (_status(first, name), _status(second, name)) for name in sorted({*first.lidars, *second.lidars})}
    return RunDifference(
        names=(str(before.path), str(after.path)),
        target=first.target,
        targets=(first.target, second.target),
        moves=tuple(
            _move(
                first.target,
                name,
                rigs,
                _variances(first, second, name),
                (within_m, within_rad),
                uncertain="uncertain" in found[name],
            )
            for name in sorted(common - {first.target})
            if first.target in common
        ),
        statuses=tuple(
            StatusChange(lidar=name, before=status, after=later, why=_why((second, first), name))
            for name, (status, later) in found.items()
            if status != later
        ),
        neither=tuple(
            PlacedByNeither(lidar=name, before=_why((first,), name), after=_why((second,), name))
            for name, statuses in found.items()
            if statuses == ("not placed", "not placed")
        ),
        stage_differences=stage_differences(first, second),
        notes=_notes(before, after),
    )


def compare_poses(
    names: tuple[str, str], before: Extrinsics, after: Extrinsics, *, within_m: float, within_rad: float
) -> RunDifference:
    """Compare two sets of poses, of which one at least is no run; a LiDAR that only one of them has counts.

    Raises:
        InputError: fewer than two LiDARs are in both.
    """
    common = sorted(before.members & after.members)
    if len(common) < 2:
        raise InputError(f"{names[0]} and {names[1]} have {len(common)} LiDARs in common; expected two or more.")
    target = before.target if before.target in common else common[0]
    rigs, limits = (before, after), (within_m, within_rad)
    # The common frame of a file may be that of the vehicle.
    compared = (before.members | after.members) - {before.target, after.target} | {*common}
    return RunDifference(
        names=names,
        target=target,
        targets=(target, target),
        moves=tuple(_move(target, name, rigs, None, limits, uncertain=False) for name in common if name != target),
        statuses=tuple(
            StatusChange(
                lidar=name,
                before="placed" if name in before.members else "missing",
                after="placed" if name in after.members else "missing",
                why="only one of the two has it",
            )
            for name in sorted(compared - {*common})
        ),
        neither=(),
        stage_differences=(),
        notes=(),
    )


def _move(
    target: str,
    lidar: str,
    rigs: tuple[Extrinsics, Extrinsics],
    variances: FloatArray | None,
    limits: tuple[float, float],
    *,
    uncertain: bool,
) -> Move:
    before, after = (rig.between(target, lidar) for rig in rigs)
    error = PoseError.between(after, before)
    sigmas = None
    if variances is not None:
        off = np.abs(np.concatenate([error.rotation_rad, error.translation_m]))
        sigmas = float(np.max(off / np.sqrt(np.maximum(variances, np.finfo(float).tiny))))
    # Rounding gives equal poses an angle.
    equal = np.array_equal(before.matrix, after.matrix)
    moved = not equal and (error.distance_m > limits[0] or error.angle_rad > limits[1])
    return Move(lidar, error, sigmas, moved, uncertain)


def _variances(before: ResultDocument, after: ResultDocument, lidar: str) -> FloatArray | None:
    """Return the (6,) variance of the difference, rotation (rad) then translation (m); None if it is not known."""
    first, second = before.lidars[lidar].covariance, after.lidars[lidar].covariance
    if before.target != after.target or first is None or second is None:
        return None
    return np.asarray(np.diag(np.asarray(first)) + np.diag(np.asarray(second)))


def _status(document: ResultDocument, lidar: str) -> PlacementStatus:
    if lidar not in document.lidars:
        return "missing"
    status = document.lidars[lidar].status
    return "not placed" if status == "not_placed" else status


def _why(documents: Sequence[ResultDocument], lidar: str) -> str:
    """Return the cause from the first document that has the LiDAR and did not place it."""
    for document in documents:
        if _status(document, lidar) in ("not placed", "uncertain"):
            explanation = explain(document)
            headlines = [each.headline for each in explanation.missing if each.lidar == lidar]
            headlines += [each.headline for each in explanation.uncertain if each.lidar == lidar]
            return headlines[0] if headlines else explanation.headline
    return "only one of the runs has it"


def _notes(before: RunDocument, after: RunDocument) -> tuple[str, ...]:
    runs, target = (before, after), before.document.target
    without = [
        f"{run.path} has no figures per stage, so stages are not compared" for run in runs if not run.document.stages
    ]
    unplaced = [
        f"{run.path} does not place {target}, so poses cannot be compared"
        for run in runs
        if target not in run.document.poses
    ]
    return (*without, *unplaced)


def difference_document(difference: RunDifference) -> DifferenceDocument:
    """Convert a difference to its JSON document."""
    return DifferenceDocument.of(
        difference,
        runs=difference.names,
        moves={
            move.lidar: MoveEntry.of(move, move.error, rotation_deg=np.rad2deg(move.error.rotation_rad))
            for move in difference.moves
        },
        placed_by_neither={each.lidar: each for each in difference.neither},
        statuses={change.lidar: change for change in difference.statuses},
        first_difference=difference.stage_differences[0].step if difference.stage_differences else None,
        differences={difference.step: difference.changes for difference in difference.stage_differences},
    )
