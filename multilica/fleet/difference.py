# SPDX-License-Identifier: Apache-2.0
"""Two runs held against each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multilica.errors import InputError, UnreadableSourceError
from multilica.explanation import explain
from multilica.extrinsics import Extrinsics
from multilica.fleet.first_difference import Parting, partings_of
from multilica.fleet.pose_error import PoseError
from multilica.fleet.run_documents import RunDocument
from multilica.geometry import FloatArray, RigidTransform

__all__ = ["Move", "PlacedByNeither", "RunDifference", "StatusChange", "compare_runs", "extrinsics_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A LiDAR that both runs placed.

    Args:
        error: the second run's pose less the first one's, along the axes of the first run's target.
        sigmas: the largest of the six differences over its standard deviation; None where that is not known.
        moved: farther than the limits.
    """

    lidar: str
    error: PoseError
    sigmas: float | None
    moved: bool


@dataclass(frozen=True, slots=True)
class StatusChange:
    """A LiDAR that only one of the runs placed.

    Args:
        before, after: ``placed``, ``not placed`` or ``not there``.
        why: the cause, of the run that did not place it.
    """

    lidar: str
    before: str
    after: str
    why: str


@dataclass(frozen=True, slots=True)
class PlacedByNeither:
    """A LiDAR that both runs have and neither placed.

    Args:
        before, after: the cause, of each run.
    """

    lidar: str
    before: str
    after: str


@dataclass(frozen=True, slots=True, eq=False)
class RunDifference:
    """How two runs differ.

    Args:
        names: of the two runs.
        target: LiDAR in whose axes the moves are.
        targets: of the two runs.
        moves: of each LiDAR that both placed, in name order, the target left out.
        statuses: of each LiDAR that one of them placed.
        neither: of each LiDAR that none of them placed, in name order.
        partings: steps at which the runs differ, in order; the first is where they part.
        notes: what could not be compared.
    """

    names: tuple[str, str]
    target: str
    targets: tuple[str, str]
    moves: tuple[Move, ...]
    statuses: tuple[StatusChange, ...]
    neither: tuple[PlacedByNeither, ...]
    partings: tuple[Parting, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether both place the same LiDARs at the same places, within the limits."""
        return not self.statuses and not any(move.moved for move in self.moves)

    @property
    def places_nothing(self) -> bool:
        """Whether neither run places a LiDAR, the target included."""
        return bool(self.neither) and self.target in {each.lidar for each in self.neither} and not self.statuses


def compare_runs(before: RunDocument, after: RunDocument, *, within_m: float, within_rad: float) -> RunDifference:
    """Hold the second run against the first.

    Args:
        within_m, within_rad: a LiDAR that differs by no more stands where it stood.

    Raises:
        UnreadableSourceError: a document is not whole.
        InputError: the runs have no LiDAR in common.
    """
    try:
        return _compared(before, after, within_m, within_rad)
    except (KeyError, AttributeError, TypeError, ValueError) as error:
        raise UnreadableSourceError(f"{before.path} or {after.path} is not a whole result: {error!r}.") from error


def _compared(before: RunDocument, after: RunDocument, within_m: float, within_rad: float) -> RunDifference:
    documents = (before.document, after.document)
    if not set(documents[0]["lidars"]) & set(documents[1]["lidars"]):
        raise InputError(f"{before.path} and {after.path} have no LiDAR in common; give two runs of one rig.")
    rigs = extrinsics_of(documents[0]), extrinsics_of(documents[1])
    target = str(documents[0]["target"])
    moves = tuple(
        _move(target, name, rigs, _variances(documents, name), (within_m, within_rad))
        for name in sorted(_placed(documents[0]) & _placed(documents[1]))
        if name != target and all(target in _placed(document) for document in documents)
    )
    return RunDifference(
        names=(str(before.path), str(after.path)),
        target=target,
        targets=(target, str(documents[1]["target"])),
        moves=moves,
        statuses=_status_changes(*documents),
        neither=_placed_by_neither(*documents),
        partings=partings_of(*documents),
        notes=_notes(before, after),
    )


def _placed(document: Mapping[str, Any]) -> set[str]:
    return {name for name, entry in document["lidars"].items() if entry["placed"]}


def extrinsics_of(document: Mapping[str, Any]) -> Extrinsics:
    """The poses of the LiDARs that a result document places."""
    target, lidars = str(document["target"]), document["lidars"]
    poses = {name: np.asarray(lidars[name]["T_target_source"], dtype=np.float64) for name in _placed(document)}
    return Extrinsics(target, {name: RigidTransform(target, name, matrix) for name, matrix in sorted(poses.items())})


def _move(
    target: str,
    lidar: str,
    rigs: tuple[Extrinsics, Extrinsics],
    variances: FloatArray | None,
    limits: tuple[float, float],
) -> Move:
    error = PoseError.between(rigs[1].between(target, lidar), rigs[0].between(target, lidar))
    sigmas = None
    if variances is not None:
        off = np.abs(np.concatenate([error.rotation_rad, error.translation_m]))
        sigmas = float(np.max(off / np.sqrt(np.maximum(variances, np.finfo(float).tiny))))
    return Move(lidar, error, sigmas, error.distance_m > limits[0] or error.angle_rad > limits[1])


def _variances(documents: tuple[Mapping[str, Any], Mapping[str, Any]], lidar: str) -> FloatArray | None:
    """(6,) variance of the difference, rotation (rad) then translation (m); only where both have the same target."""
    covariances = [document["lidars"][lidar].get("covariance") for document in documents]
    if documents[0]["target"] != documents[1]["target"] or any(each is None for each in covariances):
        return None
    return np.asarray(sum(np.diag(np.asarray(each, dtype=np.float64)) for each in covariances))


def _status_changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[StatusChange, ...]:
    names = sorted({*before["lidars"], *after["lidars"]})
    changed = [name for name in names if _status(before, name) != _status(after, name)]
    return tuple(
        StatusChange(name, _status(before, name), _status(after, name), _why((after, before), name)) for name in changed
    )


def _placed_by_neither(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[PlacedByNeither, ...]:
    return tuple(
        PlacedByNeither(name, _why((before,), name), _why((after,), name))
        for name in sorted(before["lidars"])
        if {_status(before, name), _status(after, name)} == {"not placed"}
    )


def _status(document: Mapping[str, Any], lidar: str) -> str:
    if lidar not in document["lidars"]:
        return "not there"
    return "placed" if document["lidars"][lidar]["placed"] else "not placed"


def _why(documents: Sequence[Mapping[str, Any]], lidar: str) -> str:
    """The cause that the first of the documents gives that did not place it."""
    for document in documents:
        if _status(document, lidar) == "not placed":
            told = explain(document)
            headlines = [missing.headline for missing in told.missing if missing.lidar == lidar]
            return headlines[0] if headlines else told.headline
    return "only one of the runs has it"


def _notes(before: RunDocument, after: RunDocument) -> tuple[str, ...]:
    without = [str(run.path) for run in (before, after) if not run.document.get("stages")]
    notes = [f"{name} has no figures per stage, so that stages are not compared" for name in without]
    target = before.document["target"]
    notes += [
        f"{run.path} does not place {target}, so that no pose can be compared"
        for run in (before, after)
        if target not in _placed(run.document)
    ]
    return tuple(notes)
