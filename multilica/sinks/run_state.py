# SPDX-License-Identifier: Apache-2.0
"""State of a run, accumulated from its events, with its figures per stage and the LiDARs that were not placed."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from multilica import events, results
from multilica.config import CalibrationConfig, Stage
from multilica.diagnosis import Missing, explain
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import stages as figures
from multilica.results.building import Provenance, provenance_of, result_document
from multilica.results.document import ProgressEntry, ResultDocument
from multilica.results.values import Entry
from multilica.sinks.text.log_lines import pair_label
from multilica.snapshot import Snapshot

_DIGEST_CHARACTERS = 16
_OfPair = results.PairRegistration | results.MergeCandidate | results.PairResidual | results.SurfaceMatches


class Extent(NamedTuple):
    """The dense part of a cloud.

    Args:
        centre_m: (3,) of a sphere around it.
        radius_m: of that sphere.
        reach_m: radius of the same part around the sensor.
    """

    centre_m: FloatArray
    radius_m: float
    reach_m: float


@dataclass(slots=True, eq=False)
class RunState:
    """Accumulated events of a run, from which sinks draw.

    Args:
        registrations: per pair, the registration with the latest verdict; loops that were not accepted are left out.
        group_registrations: those of groups during merging, in order.
        verified: per pair its hypotheses after verification, the one with the most evidence first.
        stages: those that finished, in order.
        rig: poses in the target's frame after the joint refinement.
        stops: names of the stops of a drive that links connect, in order.
        residuals: LiDARs with a residual of the merged cloud.
        left_out: LiDARs of which points on objects that moved are left out of the poses.
        figures: cache of `stage_figures`.
        outlines: cache of `field_of_view`.
        extents: cache of the extent of each LiDAR's cloud.
        slots_m: cache of `slot_offsets_m`.
    """

    snapshot: Snapshot | None = None
    config: CalibrationConfig | None = None
    provenance: Provenance | None = None
    stage: Stage | None = None
    stages: list[Stage] = field(default_factory=list)
    clouds: dict[str, results.PreprocessedCloud] = field(default_factory=dict)
    features: dict[str, results.FeatureCloud] = field(default_factory=dict)
    matches: dict[results.PairKey, results.Correspondences] = field(default_factory=dict)
    coarse: dict[results.PairKey, results.CoarseResult] = field(default_factory=dict)
    verified: dict[results.PairKey, tuple[results.Registration, ...]] = field(default_factory=dict)
    registrations: dict[results.PairKey, results.PairRegistration] = field(default_factory=dict)
    group_registrations: list[results.PairRegistration] = field(default_factory=list)
    target: str = ""
    target_reason: str = ""
    decisions: list[results.MergeDecision] = field(default_factory=list)
    rig: tuple[RigidTransform, ...] = ()
    stops: tuple[str, ...] = ()
    residuals: set[str] = field(default_factory=set)
    left_out: set[str] = field(default_factory=set)
    ground: events.GroundEstimated | None = None
    figures: dict[Stage, Mapping[str, Entry]] = field(default_factory=dict)
    outlines: dict[str, tuple[FloatArray, ...]] = field(default_factory=dict)
    extents: dict[str, Extent] = field(default_factory=dict)
    slots_m: dict[str, float] = field(default_factory=dict)
    result: results.CalibrationResult | None = None
    _latest: events.Event | None = None
    _document: ResultDocument | None = None

    @property
    def document(self) -> ResultDocument:
        """The facts about the run so far, with progress and figures per stage.

        Raises:
            ValueError: nothing is known before a calibration has started.
        """
        if self.config is None or self.provenance is None:
            raise ValueError("there is nothing to report before a calibration has started")
        if self._document is None:
            document = result_document(self._result_so_far(), self.config, self.provenance)
            running = self.stage if self.stage not in self.stages else None
            known = {
                "status": document.status if self.result is not None else "unfinished",
                "progress": ProgressEntry(finished=tuple(self.stages), running=running),
                "stages": stage_figures(self),
            }
            self._document = document.model_copy(update=known)
        return self._document

    def _result_so_far(self) -> results.CalibrationResult:
        """Return the result, or what is known of it; before the end no LiDAR counts as placed."""
        if self.result is not None:
            return self.result
        ended = "the run ended before it was placed"
        return results.CalibrationResult(
            target=self.target or (self.config.target if self.config is not None else ""),
            target_reason=self.target_reason or "not chosen yet",
            placements=tuple(results.LidarPlacement(name, reason=ended) for name in self.lidars),
            pairs=tuple(self.registrations.values()),
            decisions=tuple(self.decisions),
            health=tuple(cloud.health for cloud in self.clouds.values() if cloud.health is not None),
        )

    @property
    def lidars(self) -> tuple[str, ...]:
        """Names in order; none before the snapshot is known."""
        return self.snapshot.names if self.snapshot is not None else ()

    @property
    def pairs(self) -> tuple[results.PairKey, ...]:
        """All pairs that were matched or registered, in name order."""
        return tuple(sorted({*self.matches, *self.coarse, *self.registrations}))

    def pair_of(self, found: _OfPair) -> results.PairKey:
        """Return the two LiDARs in the order that `pairs` has, in which they were matched; else in their own."""
        key, reverse = (found.target, found.source), (found.source, found.target)
        return reverse if reverse in self.matches or reverse in self.registrations else key

    def registered(self, pair: results.PairKey) -> results.PairKey:
        """Return target and source of the pair's registration, to which its figures belong; else the pair as given."""
        found = self.registrations.get(pair)
        return pair if found is None else (found.target, found.source)

    def progress_of(self, pair: results.PairKey) -> tuple[bool, float, int]:
        """Return an order of pairs by how close they came to being merged."""
        found = self.registrations.get(pair)
        return (found is not None, found.evidence if found is not None else 0.0, len(self.matches.get(pair, ())))

    def competing(self, pair: results.PairKey) -> results.Registration | None:
        """Return the pose that makes the pair's registration, or the LiDAR that it would place, doubtful."""
        found = self.registrations[pair]
        if found.competing is not None or self.result is None:
            return found.competing
        contested = (place.contested for place in self.result.placements if place.contested is not None)
        return next((each.competing for each in contested if {*each.pair} == {*pair}), None)

    def __call__(self, event: events.Event) -> None:  # noqa: C901, PLR0912 - one case per event type
        """Take in an event, once even if several sinks share the state."""
        if event is self._latest:
            return
        self._latest, self._document = event, None
        match event:
            case events.CalibrationStarted(snapshot, config, _, stops):
                self.snapshot, self.config, self.stops = snapshot, config, stops
                self.provenance = provenance_of(snapshot)
            case events.StageStarted(stage):
                self.stage = stage
            case events.StageFinished(stage):
                self.stages.append(stage)
            case events.CloudPreprocessed(cloud):
                self.clouds[cloud.lidar] = cloud.slim()
                self.extents.pop(cloud.lidar, None)
            case events.FeaturesComputed(features):
                self.features[features.lidar] = features
            case events.CorrespondencesMatched(matches):
                self.matches[matches.target, matches.source] = matches
            case events.HypothesesFound(coarse):
                self.coarse[coarse.target, coarse.source] = coarse
            case events.HypothesesVerified(target, source, scored_poses):
                self.verified[target, source] = scored_poses
            case events.PairRegistered(registration) | events.VerdictChanged(registration):
                self.registrations[self.pair_of(registration)] = registration
            case events.GroupsRegistered(registration):
                self.group_registrations.append(registration)
            case events.LoopRegistered(registration):
                if registration.verdict.accepted:
                    self.registrations[self.pair_of(registration)] = registration
            case events.TargetChosen(target, reason):
                self.target, self.target_reason = target, reason
            case events.MergeStepTaken(decision):
                self.decisions.append(decision)
            case events.RigRefined(_, poses):
                self.rig = poses
            case events.MovableFound(lidar, points_m, _, moved) if moved and len(points_m):
                self.left_out.add(lidar)
            case events.ResidualsMeasured(residuals):
                self.residuals.add(residuals.lidar)
            case events.GroundEstimated():
                self.ground = event
            case events.CalibrationFinished(result):
                self.result = result


def stage_figures(state: RunState) -> figures.StageFigures:
    """Return the figures of each finished stage that has any, per LiDAR, pair or step.

    Digests replace arrays that are the same bits in equal runs, with any number of worker processes.
    """
    stages = [stage for stage in state.stages if stage in _FIGURES]
    for stage in stages:
        if stage not in state.figures:
            state.figures[stage] = _FIGURES[stage](state)
    return figures.StageFigures(**{stage: state.figures[stage] for stage in stages})


def _digest(*arrays: npt.NDArray[Any]) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:_DIGEST_CHARACTERS]


def _coarse(coarse: results.CoarseResult) -> figures.CoarseFigures:
    best = coarse.hypotheses[:1]
    known = [part for one in best for part in (one.T_target_source, one)]
    solver = {"solver": best[0].origin} if best else {}
    return figures.CoarseFigures.of(*known, coarse, hypotheses=len(coarse.hypotheses), **solver)


def _verify(found: tuple[results.Registration, ...]) -> figures.VerifyFigures:
    best = [part for one in found[:1] for part in (one.T_target_source, one.visibility, one)]
    return figures.VerifyFigures.of(*best, distinct=len(found))


def _merge(decision: results.MergeDecision) -> figures.MergeFigures:
    chosen, groups = decision.chosen, "; ".join(" + ".join(group) for group in decision.groups)
    if chosen is None:
        return figures.MergeFigures(chosen=None, fitness=None, groups=groups)
    return figures.MergeFigures(chosen=pair_label(chosen.target, chosen.source), fitness=chosen.fitness, groups=groups)


_FIGURES: Mapping[Stage, Callable[[RunState], Mapping[str, Entry]]] = {
    "ingest": lambda state: {
        lidar.name: figures.IngestFigures(
            frames=len(lidar.scans), points=lidar.points_count, digest=_digest(*(scan.points_m for scan in lidar.scans))
        )
        for lidar in (state.snapshot.lidars if state.snapshot is not None else ())
    },
    "preprocess": lambda state: {
        name: figures.PreprocessFigures(
            returns=cloud.returns,
            points=len(cloud.points_m),
            dropped={reason: len(points_m) for reason, points_m in sorted(cloud.dropped_m.items())},
            digest=_digest(cloud.points_m),
        )
        for name, cloud in state.clouds.items()
    },
    "features": lambda state: {
        name: figures.FeatureFigures(points=len(cloud.points_m), digest=_digest(cloud.points_m, cloud.descriptors))
        for name, cloud in state.features.items()
    },
    "correspond": lambda state: {
        pair_label(*pair): figures.CorrespondFigures(
            matches=len(matches), digest=_digest(matches.target_points_m, matches.source_points_m)
        )
        for pair, matches in state.matches.items()
    },
    "coarse": lambda state: {pair_label(*pair): _coarse(coarse) for pair, coarse in state.coarse.items()},
    "verify": lambda state: {pair_label(*pair): _verify(found) for pair, found in state.verified.items()},
    "fine": lambda state: {
        pair_label(found.target, found.source): figures.FineFigures.of(
            found.T_target_source, found, verdict=found.verdict.outcome
        )
        for found in state.registrations.values()
    },
    "merge": lambda state: {f"step {decision.step}": _merge(decision) for decision in state.decisions},
    "refine": lambda state: {pose.source: figures.PoseFigures.of(pose) for pose in state.rig},
    "ground": lambda state: (
        {}
        if state.ground is None or state.ground.ground is None
        else {"plane": figures.GroundFigures.of(state.ground.ground)}
    ),
}


class Failure(NamedTuple):
    """A LiDAR that was not placed.

    Args:
        stage: the stage at which it failed.
        pair: the decisive pair, as it was matched; None if there was none.
        elsewhere: the other accepted pair, which puts it at another place.
    """

    lidar: str
    stage: Stage
    pair: results.PairKey | None
    elsewhere: results.PairKey | None = None


def failures(state: RunState) -> tuple[Failure, ...]:
    """Return every LiDAR that was not placed; none for a run without a result."""
    return tuple(_failure(state, missing) for missing in explain(state.document).missing)


def decisive_failure(state: RunState) -> Failure | None:
    """Return the first failure with a registered pair, else the first with any pair, else the first."""
    return min(
        failures(state), key=lambda each: (each.pair not in state.registrations, each.pair is None), default=None
    )


def _failure(state: RunState, missing: Missing) -> Failure:
    """Return the failure with the pair that the explanation calls decisive: both are shown side by side."""
    if missing.cause in ("dead_sensor", "no_returns_in_range"):
        return Failure(missing.lidar, "preprocess", None)
    if missing.decisive is not None:
        stage: Stage = "fine" if missing.decisive.codes else "merge"
        # None of a joint result is in the state.
        known = {frozenset(key): key for key in state.registrations}
        given = (missing.decisive, missing.elsewhere)
        pairs = (None if each is None else known.get(frozenset(each.key)) for each in given)
        return Failure(missing.lidar, stage, *pairs)
    if not state.matches:
        return Failure(missing.lidar, "merge", None)
    own = [pair for pair in state.pairs if missing.lidar in pair]
    pair = max(own, key=lambda pair: (state.progress_of(pair), pair), default=None)
    return Failure(missing.lidar, "coarse" if pair is not None and state.matches.get(pair) else "correspond", pair)
