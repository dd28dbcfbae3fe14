# SPDX-License-Identifier: Apache-2.0
"""The result document of a run, whether it has ended or not."""

import math
from typing import Any

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
from multilica.results.document.lidars import ContestedEntry, LidarEntry, PriorEntry
from multilica.results.document.pairs import CycleErrorEntry, PairEntry, RefinementEntry, RegistrationEntry
from multilica.results.document.result import RESULT_SCHEMA, GroundEntry, ProgressEntry, ResultDocument, SnapshotEntry
from multilica.sinks.files.provenance import Provenance
from multilica.sinks.run_state import RunState
from multilica.sinks.text.prior_comparison import exchanged_names, surprise
from multilica.sinks.text.stage_figures import stage_figures


def run_document(state: RunState) -> ResultDocument | None:
    """Return what is known of a run so far, with progress and figures per stage; None before it has started.

    Sinks that share a state share the document.
    """
    if state.document is None and state.config is not None and state.provenance is not None:
        document = result_document(result_so_far(state), state.config, state.provenance)
        running = state.stage if state.stage not in state.stages else None
        known = {
            "progress": ProgressEntry(finished=tuple(state.stages), running=running),
            "stages": stage_figures(state),
        }
        state.document = document.model_copy(
            update=known if state.result is not None else {"status": "unfinished", **known}
        )
    return state.document


def result_so_far(state: RunState) -> CalibrationResult:
    """Return the result, or what is known of it; before the end no LiDAR counts as placed."""
    if state.result is not None:
        return state.result
    target = state.target or (state.config.target if state.config is not None else "")
    return CalibrationResult(
        target=target,
        target_reason=state.target_reason or "not chosen yet",
        placements=tuple(LidarPlacement(name, reason="the run ended before it was placed") for name in state.lidars),
        pairs=tuple(state.registrations.values()),
        decisions=tuple(state.decisions),
        health=tuple(cloud.health for cloud in state.clouds.values() if cloud.health is not None),
    )


def result_document(result: CalibrationResult, config: CalibrationConfig, provenance: Provenance) -> ResultDocument:
    """Convert a result to the document that `result.json` holds."""
    health = {each.lidar: each for each in result.health}
    exchanged = exchanged_names(result.placements, result.target)
    return ResultDocument.of(
        result,
        provenance,
        schema=RESULT_SCHEMA,
        accepted_by="evidence" if config.verify.enabled else "fitness",
        lidars={
            each.lidar: _lidar(each, health.get(each.lidar), result.target, exchanged) for each in result.placements
        },
        pairs=tuple(map(_pair, result.pairs)),
        snapshots=tuple(map(_snapshot, result.snapshots)),
        refinement=None if result.refinement is None else _refinement(result.refinement),
        ground=None if result.ground is None else _ground(result.ground),
        config=config,
    )


def _pose(T_target_source: RigidTransform | None) -> dict[str, Any]:
    names = ("xyz_m", "rpy_deg", "quaternion_xyzw")
    matrix = None if T_target_source is None else T_target_source.matrix
    return {"T_target_source": matrix, **{name: getattr(T_target_source, name, None) for name in names}}


def _lidar(
    placement: LidarPlacement, health: SensorHealth | None, target: str, exchanged: tuple[str, str] | None
) -> LidarEntry:
    contested, prior = placement.contested, placement.T_target_source_prior
    return LidarEntry.of(
        placement,
        **_pose(placement.T_target_source),
        prior=None if prior is None else _prior(prior, placement, target, exchanged),
        contested=contested and ContestedEntry.of(contested, angle_deg=math.degrees(contested.angle_rad)),
        health=health,
    )


def _prior(
    prior: RigidTransform, placement: LidarPlacement, target: str, exchanged: tuple[str, str] | None
) -> PriorEntry:
    off_m, off_rad = placement.prior_deviation or (math.nan, math.nan)
    off_deg = math.degrees(off_rad)
    text = surprise(placement, target, exchanged)
    return PriorEntry(**_pose(prior), deviation_m=off_m, deviation_deg=off_deg, surprise=text)


def _snapshot(snapshot: SnapshotReport) -> SnapshotEntry:
    outliers = [deviation.lidar for deviation in snapshot.outliers]
    refusal = snapshot.refusal or None
    return SnapshotEntry.of(snapshot, sha256=snapshot.source_sha256, refusal=refusal, outliers=outliers)


def _refinement(refinement: Refinement) -> RefinementEntry:
    before, after = (
        CycleErrorEntry(m=m, deg=deg)
        for m, deg in zip(refinement.cycle_error_m, refinement.cycle_error_deg, strict=True)
    )
    return RefinementEntry(cycle_error_before=before, cycle_error_after=after, pairs=refinement.pairs)


def _pair(pair: PairRegistration) -> PairEntry:
    registrations = [
        RegistrationEntry.of(found.visibility, found, T_target_source=found.T_target_source.matrix)
        for found in pair.registrations
    ]
    return PairEntry.of(pair, **_pose(pair.T_target_source), registrations=registrations)


def _ground(ground: GroundPlane) -> GroundEntry:
    rig = ground.T_base_target_rig
    return GroundEntry.of(
        ground.T_base_target,
        ground,
        T_base_target=ground.T_base_target.matrix,
        T_base_target_rig=None if rig is None else rig.matrix,
    )
