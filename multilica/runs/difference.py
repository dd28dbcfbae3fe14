# SPDX-License-Identifier: Apache-2.0
"""Comparison of two runs."""

from collections.abc import Iterator, Mapping, Sequence
from math import isclose
from typing import Any, Literal

import numpy as np
from pydantic import Field

from multilica.config import STAGES
from multilica.diagnosis import explain
from multilica.errors import InputError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray
from multilica.results.document import ResultDocument
from multilica.results.values import Entry, Number, Vector3
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import RunDocument

# On another CPU equal runs agree to this.
_SAME = 1e-6

PlacementStatus = Literal["placed", "uncertain", "not placed", "missing"]


class Move(Entry):
    """A LiDAR with a pose in both runs; second run - first run, along the axes of the first run's target.

    It moved by more than the limits if `moved`; one of the two poses is uncertain if `uncertain`. `sigmas` is the
    largest of the six differences divided by its standard deviation; null without covariances.
    """

    moved: bool
    uncertain: bool
    distance_m: float
    angle_deg: float
    translation_m: Vector3
    rotation_deg: Vector3
    sigmas: Number


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


class Change(Entry):
    """A value that differs between two runs; None in a run that lacks it."""

    what: str = Field(description="Names of the keys that lead to it, joined by dots.")
    before: Any
    after: Any


class RunDifference(Entry):
    """Differences between two runs, the output of `multilica diff --json`; null stands for what is not known.

    Args:
        same: whether both place the same LiDARs at the same poses, within the limits.
        target: LiDAR in whose axes the moves are.
        moves: per LiDAR with a pose in both runs, in name order, without the target.
        placed_by_neither: per LiDAR that none of them placed, in name order.
        statuses: per LiDAR that they do not agree on.
        differences: per step at which the runs differ, in order: `input`, `config`, `versions`, or a stage.
        notes: what could not be compared.
    """

    schema_: Literal["multilica/difference/1"] = Field("multilica/difference/1", alias="schema")
    runs: tuple[str, str]
    same: bool
    target: str
    targets: tuple[str, str]
    moves: Mapping[str, Move]
    placed_by_neither: Mapping[str, PlacedByNeither]
    statuses: Mapping[str, StatusChange]
    first_difference: str | None = None
    differences: Mapping[str, tuple[Change, ...]]
    notes: tuple[str, ...] = ()


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
    limits = within_m, within_rad
    moves = {
        name: _move(
            first.target, name, rigs, _variances(first, second, name), limits, uncertain="uncertain" in found[name]
        )
        for name in sorted(common - {first.target})
        if first.target in common
    }
    statuses = {
        name: StatusChange(lidar=name, before=status, after=later, why=_why((second, first), name))
        for name, (status, later) in found.items()
        if status != later
    }
    neither = {
        name: PlacedByNeither(lidar=name, before=_why((first,), name), after=_why((second,), name))
        for name, both in found.items()
        if both == ("not placed", "not placed")
    }
    differences = stage_differences(first, second)
    return RunDifference(
        runs=(str(before.path), str(after.path)),
        same=not statuses and not any(move.moved for move in moves.values()),
        target=first.target,
        targets=(first.target, second.target),
        moves=moves,
        placed_by_neither=neither,
        statuses=statuses,
        first_difference=next(iter(differences), None),
        differences=differences,
        notes=_notes(before, after),
    )


def compare_poses(
    names: tuple[str, str], before: Extrinsics, after: Extrinsics, *, within_m: float, within_rad: float
) -> RunDifference:
    """Compare two sets of poses; at least one of them is no run; a LiDAR that only one of them has counts.

    Raises:
        InputError: fewer than two LiDARs are in both.
    """
    common = sorted(before.members & after.members)
    if len(common) < 2:
        raise InputError(f"{names[0]} and {names[1]} have {len(common)} LiDARs in common; expected two or more.")
    target = before.target if before.target in common else common[0]
    rigs, limits = (before, after), (within_m, within_rad)
    # The common frame of a file may be that of the vehicle.
    compared = before.T_target_source.keys() | after.T_target_source.keys() | {*common}
    moves = {name: _move(target, name, rigs, None, limits, uncertain=False) for name in common if name != target}
    statuses = {
        name: StatusChange(
            lidar=name,
            before="placed" if name in before.members else "missing",
            after="placed" if name in after.members else "missing",
            why="only one of the two has it",
        )
        for name in sorted(compared - {*common})
    }
    return RunDifference(
        runs=names,
        same=not statuses and not any(move.moved for move in moves.values()),
        target=target,
        targets=(target, target),
        moves=moves,
        placed_by_neither={},
        statuses=statuses,
        differences={},
        notes=("a file of poses has no stages, so only poses are compared",),
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
    return Move.of(error, moved=moved, uncertain=uncertain, rotation_deg=np.rad2deg(error.rotation_rad), sigmas=sigmas)


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
            headlines = (each.headline for each in explanation.unclear if each.lidar == lidar)
            return next(headlines, explanation.headline)
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


def stage_differences(before: ResultDocument, after: ResultDocument) -> dict[str, tuple[Change, ...]]:
    """Return every step at which two runs differ, in order; stages are compared if both have figures of them."""
    # The same bytes under another name are the same input.
    unread = {"source"} if before.input.sha256 and before.input.sha256 == after.input.sha256 else set()
    first, second = (
        {
            "input": each.input.model_dump(mode="json", exclude=unread),
            "config": each.config.model_dump(mode="json"),
            "versions": each.versions,
            **(each.stages.model_dump(mode="json") if each.stages else {}),
        }
        for each in (before, after)
    )
    steps = [step for step in ("input", "config", "versions", *STAGES) if step in first and step in second]
    found = {step: tuple(changes_between(first[step], second[step])) for step in steps}
    return {step: changes for step, changes in found.items() if changes}


def changes_between(before: object, after: object, what: str = "") -> Iterator[Change]:
    """Yield the leaves in which two documents differ, floats by more than 1e-6."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in [*before, *(key for key in after if key not in before)]:
            yield from changes_between(before.get(key), after.get(key), f"{what}.{key}" if what else str(key))
    elif not _same(before, after):
        yield Change(what=what, before=before, after=after)


def _same(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return isclose(before, after, rel_tol=_SAME, abs_tol=_SAME)
    if isinstance(before, list) and isinstance(after, list):
        return len(before) == len(after) and all(_same(*pair) for pair in zip(before, after, strict=True))
    return before == after
