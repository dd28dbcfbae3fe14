# SPDX-License-Identifier: Apache-2.0
"""What is known of a calibration so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from multilica import events
from multilica.config import CalibrationConfig, Stage
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import (
    Assessment,
    CalibrationResult,
    CoarseResult,
    Correspondences,
    FeatureCloud,
    MergeDecision,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
)
from multilica.sinks.provenance import Provenance, provenance_of
from multilica.snapshot import Snapshot

__all__ = ["RunStory", "as_matched"]


def as_matched(pair: PairKey, pose: RigidTransform) -> RigidTransform:
    """The pose of the pair's source in its target, whichever way round it was registered."""
    return pose if pose.target == pair[0] else pose.inverse()


@dataclass(slots=True, eq=False)
class RunStory:
    """An observer that remembers; everything else in a recording's summary and blueprint derives from it.

    Args:
        registrations: per pair, as it was matched, the registration of stage fine, or the one by which stage refine
            closed a loop; those of merged clouds, and loops that did not close, are left out.
        assessments: per pair its hypotheses by visibility, the most believable first.
        stages: those that finished, in order.
        rig: poses in the target's frame after the joint adjustment.
        document: of what is known, as far as somebody asked for it, see `run_document`.
        figures: of stages that finished, as far as somebody asked for them, see `stage_figures`.
        extents: centre and radius of clouds, as far as somebody asked for them, see `rerun_camera`.
        outlines: of fields of view, as far as somebody asked for them, see `field_of_view`.
    """

    snapshot: Snapshot | None = None
    config: CalibrationConfig | None = None
    provenance: Provenance | None = None
    stage: Stage | None = None
    stages: list[Stage] = field(default_factory=list)
    clouds: dict[str, PreprocessedCloud] = field(default_factory=dict)
    features: dict[str, FeatureCloud] = field(default_factory=dict)
    matches: dict[PairKey, Correspondences] = field(default_factory=dict)
    coarse: dict[PairKey, CoarseResult] = field(default_factory=dict)
    assessments: dict[PairKey, tuple[Assessment, ...]] = field(default_factory=dict)
    registrations: dict[PairKey, PairRegistration] = field(default_factory=dict)
    merged_registrations: list[PairRegistration] = field(default_factory=list)
    target: str = ""
    target_reason: str = ""
    decisions: list[MergeDecision] = field(default_factory=list)
    rig: tuple[RigidTransform, ...] = ()
    ground: events.GroundEstimated | None = None
    document: dict[str, Any] | None = None
    figures: dict[Stage, Mapping[str, Any]] = field(default_factory=dict)
    extents: dict[str, tuple[FloatArray, float]] = field(default_factory=dict)
    outlines: dict[str, tuple[FloatArray, ...]] = field(default_factory=dict)
    result: CalibrationResult | None = None
    _latest: events.Event | None = None

    @property
    def lidars(self) -> tuple[str, ...]:
        """Names in order; none before the snapshot is known."""
        return self.snapshot.names if self.snapshot is not None else ()

    @property
    def pairs(self) -> tuple[PairKey, ...]:
        """Every pair that was looked at, in name order."""
        return tuple(sorted({*self.matches, *self.coarse, *self.registrations}))

    def pair_of(self, registration: PairRegistration) -> PairKey:
        """The pair as it was matched, whichever way round it was registered."""
        target, source = registration.target, registration.source
        return (source, target) if (source, target) in self.matches else (target, source)

    def __call__(self, event: events.Event) -> None:  # noqa: C901, PLR0912 - one case per event type
        """Remember what the event tells; once, however many of the sinks that share a story tell it."""
        if event is self._latest:
            return
        self._latest, self.document = event, None
        match event:
            case events.CalibrationStarted(snapshot, config):
                self.snapshot, self.config = snapshot, config
                self.provenance = provenance_of(snapshot)
            case events.StageStarted(stage):
                self.stage = stage
            case events.StageFinished(stage):
                self.stages.append(stage)
            case events.CloudPreprocessed(cloud):
                self.clouds[cloud.lidar] = cloud
            case events.FeaturesComputed(features):
                self.features[features.lidar] = features
            case events.CorrespondencesMatched(matches):
                self.matches[matches.target, matches.source] = matches
            case events.HypothesesFound(coarse):
                self.coarse[coarse.target, coarse.source] = coarse
            case events.HypothesesAssessed(target, source, assessments):
                self.assessments[target, source] = assessments
            case events.PairRegistered(registration):
                if self.stage == "merge":
                    self.merged_registrations.append(registration)
                elif self.stage != "refine" or registration.verdict.accepted:
                    self.registrations[self.pair_of(registration)] = registration
            case events.TargetChosen(target, reason):
                self.target, self.target_reason = target, reason
            case events.MergeStepTaken(decision):
                self.decisions.append(decision)
            case events.RigRefined(_, poses):
                self.rig = poses
            case events.GroundEstimated():
                self.ground = event
            case events.CalibrationFinished(result):
                self.result = result
