# SPDX-License-Identifier: Apache-2.0
"""Conversion of a calibration result to its document."""

import math
from typing import Any, TypeVar

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import (
    CalibrationResult,
    GroundPlane,
    LidarPlacement,
    PairRegistration,
    Refinement,
    SensorHealth,
    SnapshotReport,
)
from multilica.results.document import (
    RESULT_SCHEMA,
    ContestedEntry,
    CycleErrorEntry,
    GroundEntry,
    LidarEntry,
    PairEntry,
    PriorEntry,
    RefinementEntry,
    RegistrationEntry,
    ResultDocument,
    SnapshotEntry,
)
from multilica.results.document.values import Entry
from multilica.sinks.files.provenance import Provenance
from multilica.sinks.text.prior_comparison import surprise

__all__ = ["result_document"]

EntryT = TypeVar("EntryT", bound=Entry)


def result_document(result: CalibrationResult, config: CalibrationConfig, provenance: Provenance) -> ResultDocument:
    """Convert a result to the document that `result.json` holds."""
    health = {each.lidar: each for each in result.health}
    return _entry(
        ResultDocument,
        result,
        provenance,
        schema=RESULT_SCHEMA,
        lidars={each.lidar: _lidar(each, health.get(each.lidar), result.target) for each in result.placements},
        pairs=tuple(map(_pair, result.pairs)),
        snapshots=tuple(map(_snapshot, result.snapshots)),
        refinement=None if result.refinement is None else _refinement(result.refinement),
        ground=None if result.ground is None else _ground(result.ground),
        config=config,
    )


def _entry(kind: type[EntryT], *sources: object, **values: object) -> EntryT:
    """Fill an entry with those values, else with the attributes of the same name of the sources."""
    found = {name: getattr(source, name) for source in sources for name in kind.model_fields if hasattr(source, name)}
    return kind(**found | values)


def _pose(T_target_source: RigidTransform | None) -> dict[str, Any]:
    names = ("xyz_m", "rpy_deg", "quaternion_xyzw")
    matrix = None if T_target_source is None else T_target_source.matrix
    return {"T_target_source": matrix, **{name: getattr(T_target_source, name, None) for name in names}}


def _lidar(placement: LidarPlacement, health: SensorHealth | None, target: str) -> LidarEntry:
    contested, prior = placement.contested, placement.T_target_source_prior
    return _entry(
        LidarEntry,
        placement,
        **_pose(placement.T_target_source),
        prior=None if prior is None else _prior(prior, placement, target),
        contested=contested and _entry(ContestedEntry, contested, angle_deg=math.degrees(contested.angle_rad)),
        health=health,
    )


def _prior(prior: RigidTransform, placement: LidarPlacement, target: str) -> PriorEntry:
    off_m, off_rad = placement.prior_deviation or (math.nan, math.nan)
    off_deg = math.degrees(off_rad)
    return PriorEntry(**_pose(prior), deviation_m=off_m, deviation_deg=off_deg, surprise=surprise(placement, target))


def _snapshot(snapshot: SnapshotReport) -> SnapshotEntry:
    outliers = [deviation.lidar for deviation in snapshot.outliers]
    refusal = snapshot.refusal or None
    return _entry(SnapshotEntry, snapshot, sha256=snapshot.source_sha256, refusal=refusal, outliers=outliers)


def _refinement(refinement: Refinement) -> RefinementEntry:
    before, after = (
        CycleErrorEntry(m=m, deg=deg)
        for m, deg in zip(refinement.cycle_error_m, refinement.cycle_error_deg, strict=True)
    )
    return RefinementEntry(cycle_error_before=before, cycle_error_after=after, pairs=refinement.pairs)


def _pair(pair: PairRegistration) -> PairEntry:
    registrations = [
        _entry(RegistrationEntry, found.visibility, found, T_target_source=found.T_target_source.matrix)
        for found in pair.registrations
    ]
    return _entry(PairEntry, pair, **_pose(pair.T_target_source), registrations=registrations)


def _ground(ground: GroundPlane) -> GroundEntry:
    return _entry(GroundEntry, ground.T_base_target, ground, T_base_target=ground.T_base_target.matrix)
