# SPDX-License-Identifier: Apache-2.0
"""What each stage finds: one frozen type per stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform
from multilica.testimony import Testimony

__all__ = [
    "PRIOR",
    "Assessment",
    "CalibrationResult",
    "CoarseResult",
    "Correspondences",
    "EdgeResidual",
    "FeatureCloud",
    "FineStep",
    "GroundPlane",
    "Hypothesis",
    "LidarPlacement",
    "MergeCandidate",
    "MergeDecision",
    "PairKey",
    "PairRegistration",
    "PreprocessedCloud",
    "Reason",
    "Refinement",
    "Refusal",
    "SensorHealth",
    "SigmaOrigin",
    "SnapshotDeviation",
    "SnapshotReport",
    "Spread",
    "Status",
    "Verdict",
    "hypothesis_label",
]

IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
PairKey = tuple[str, str]
"""(target, source): names of the two LiDARs."""
Status = Literal["complete", "partial", "failed"]
PRIOR = "prior"
"""Origin and name of the hypothesis that was known beforehand."""
SigmaOrigin = Literal["residuals", "snapshots"]
"""What a covariance rests on: the residuals of the registrations, or those widened to the spread over snapshots."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a registration was not accepted, or a sensor not trusted, as data.

    Args:
        code: stable name, for programs.
        value, limit: the figure and what it was held against.
        text: the same for people.
    """

    code: str
    value: float
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """What a LiDAR's returns say of the LiDAR itself.

    Args:
        returns: finite returns over all frames.
        near_share: share of them that is too near to be used: the vehicle's body, or dirt.
        soiled_share: share of the field of view that ends on the window.
        reasons: `dead` or `dirty`; none for a LiDAR that is well.
    """

    lidar: str
    returns: int
    near_share: float
    soiled_share: float
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PreprocessedCloud:
    """One LiDAR's returns after cleaning.

    Args:
        lidar: name.
        returns_m: (R, 3) every kept return in the LiDAR's own frame: one beam each.
        points_m: (N, 3) the same, thinned on the voxel grid.
        dropped_m: per reason, the (K, 3) points that were dropped.
        health: None where the sensor was not examined.
    """

    lidar: str
    returns_m: FloatArray
    points_m: FloatArray
    dropped_m: Mapping[str, FloatArray] = field(default_factory=dict)
    health: SensorHealth | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FeatureCloud:
    """Descriptors of one LiDAR's thinned cloud.

    Args:
        points_m: (N, 3); normals: (N, 3) unit; descriptors: (N, 33) FPFH.
    """

    lidar: str
    points_m: FloatArray
    normals: FloatArray
    descriptors: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Matched points of two LiDARs, best first; row i of each array belongs to match i.

    Args:
        target_points_m, source_points_m: (M, 3), each in its own LiDAR's frame.
        target_normals, source_normals: (M, 3) unit.
        feature_distances: (M,) distance in descriptor space.
    """

    target: str
    source: str
    target_points_m: FloatArray
    source_points_m: FloatArray
    target_normals: FloatArray
    source_normals: FloatArray
    feature_distances: FloatArray

    def __len__(self) -> int:
        return len(self.target_points_m)

    def subset(self, index: IndexArray) -> Correspondences:
        """The matches of those indices."""
        return Correspondences(
            self.target,
            self.source,
            self.target_points_m[index],
            self.source_points_m[index],
            self.target_normals[index],
            self.source_normals[index],
            self.feature_distances[index],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose that a set of matches agrees on.

    Args:
        inliers: (M,) which matches agree; all False where the solver does not tell.
        score: number of agreeing matches; the order in which hypotheses are tried.
        origin: the solver, or `PRIOR`.
    """

    T_target_source: RigidTransform
    inliers: BoolArray
    score: float
    origin: str


def hypothesis_label(index: int, origin: str) -> str:
    """How a hypothesis is called wherever people read it: by its index, or as the prior."""
    return PRIOR if origin == PRIOR else str(index)


@dataclass(frozen=True, slots=True, eq=False)
class CoarseResult:
    """The hypotheses of a pair, the solver's best first; empty if the matches agree on nothing and nothing is known.

    Args:
        hypotheses: that of the prior, if there is one, comes last, so that it changes no other's index.
        graph_nodes, graph_edges: size of the consistency graph; 0 where the solver builds none.
    """

    target: str
    source: str
    hypotheses: tuple[Hypothesis, ...]
    graph_nodes: int = 0
    graph_edges: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """One hypothesis after GICP, judged by visibility.

    Args:
        hypothesis: index into the pair's hypotheses; -1 if it came from other pairs during merging.
        origin: of that hypothesis; "" if it came from other pairs.
        weakest_curvature: smallest eigenvalue of the GICP Hessian per inlier, rotations scaled by 10 m: near zero where
            the pose can slide without the fit getting worse.
        probes_m: (N, 3) judged points of the source, in its own frame, to which `testimony.labels` belong.
        target_probes_m: (M, 3) judged points of the target, in its own frame, as `testimony.target_labels`.
        hold: what holds the pose; None where that is beyond doubt, or does not matter any more.
    """

    hypothesis: int
    T_target_source: RigidTransform
    testimony: Testimony
    fitness: float
    rmse_m: float
    weakest_curvature: float
    probes_m: FloatArray
    origin: str = ""
    target_probes_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    hold: Hold | None = None

    @property
    def label(self) -> str:
        """How its hypothesis is called wherever people read it."""
        return hypothesis_label(self.hypothesis, self.origin)

    @property
    def evidence(self) -> float:
        """See `Testimony.evidence`."""
        return self.testimony.evidence


@dataclass(frozen=True, slots=True)
class Hold:
    """How firmly the points of both clouds hold a registered pose. Turns count as arcs 10 m away.

    Args:
        sigma_m, sigma_rad: standard deviations of position and attitude in their weakest directions; None where the
            engine gives no normals.
        push_m: how far the pose was pushed along its weakest direction, either way.
        pushed_off_m: how far from the pose the registration ends when it starts from there.
        thinned_off_m: how far from the pose the registration of fewer points ends.
    """

    sigma_m: float | None
    sigma_rad: float | None
    push_m: float
    pushed_off_m: float
    thinned_off_m: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a registration is believed; `accept` has no reasons."""

    outcome: Literal["accept", "undecided", "reject"]
    reasons: tuple[Reason, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether it may be merged."""
        return self.outcome == "accept"


@dataclass(frozen=True, slots=True)
class FineStep:
    """One observed moment of GICP.

    Args:
        iteration: iterations done since the start.
        error: the engine's objective; nan where it does not tell.
        translation_step_m, rotation_step_rad: movement since the last observed moment.
    """

    iteration: int
    max_correspondence_distance_m: float
    inliers: int
    error: float
    translation_step_m: float
    rotation_step_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class PairRegistration:
    """GICP's result for a pair.

    Args:
        target, source: LiDARs, or during merging the LiDAR and the group it was registered against.
        fitness: source points within `fine.fitness_distance_m` of the target cloud, as a share of all source points.
        rmse_m: root mean square distance of those points to their nearest target point.
        hessian: (6, 6) of the objective, order rotation xyz, translation xyz about the source frame; None where the
            engine does not tell.
        information: (6, 6) inverse covariance of the pose, order rotation (rad), translation (m) along the target's
            axes, the rotation about the source's origin; None where too few points match.
        hypothesis: index into the pair's hypotheses that this started from; -1 if it started from a merged pose.
        steps: progress, for the recording.
        assessments: the finely registered answers, the chosen one first; empty where verification is off.
    """

    target: str
    source: str
    T_target_source: RigidTransform
    fitness: float
    rmse_m: float
    inliers: int
    converged: bool
    iterations: int
    engine: str
    hypothesis: int = 0
    hessian: FloatArray | None = None
    information: FloatArray | None = None
    steps: tuple[FineStep, ...] = ()
    assessments: tuple[Assessment, ...] = ()
    verdict: Verdict = Verdict("accept")

    @property
    def start_label(self) -> str:
        """How the hypothesis that it started from is called."""
        return self.assessments[0].label if self.assessments else str(self.hypothesis)

    @property
    def evidence(self) -> float:
        """Of the pose that was chosen; the fitness where nothing was verified."""
        return self.assessments[0].evidence if self.assessments else self.fitness


@dataclass(frozen=True, slots=True)
class MergeCandidate:
    """A pair that a merge step could have chosen; `reason` says why it does not pass."""

    target: str
    source: str
    fitness: float
    rmse_m: float
    passes: bool
    evidence: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MergeDecision:
    """One turn of Algorithm 1.

    Args:
        step: from 0.
        candidates: what could have been chosen, best first.
        chosen: the pair that was merged; None when the algorithm stopped.
        reason: why, in one sentence with its figures.
        groups: members of every connected group after the step, largest first.
    """

    step: int
    candidates: tuple[MergeCandidate, ...]
    chosen: MergeCandidate | None
    reason: str
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class EdgeResidual:
    """By how much the poses of a rig disagree with one of its pairs, before and after the joint adjustment.

    Args:
        weight: what the pair counted for in the end, from 1 down to 0 for an outlier.
        snapshot: the snapshot that the pair is of; empty where there is only one.
    """

    target: str
    source: str
    before_m: float
    before_deg: float
    after_m: float
    after_deg: float
    weight: float
    snapshot: str = ""


@dataclass(frozen=True, slots=True)
class Refinement:
    """What the joint adjustment did; without loops nothing is left to adjust."""

    edges: tuple[EdgeResidual, ...] = ()

    @property
    def cycle_error_m(self) -> tuple[float, float]:
        """Largest disagreement in metres before and after."""
        return (
            max((edge.before_m for edge in self.edges), default=0.0),
            max((edge.after_m for edge in self.edges), default=0.0),
        )

    @property
    def cycle_error_deg(self) -> tuple[float, float]:
        """Largest disagreement in degrees before and after."""
        return (
            max((edge.before_deg for edge in self.edges), default=0.0),
            max((edge.after_deg for edge in self.edges), default=0.0),
        )


@dataclass(frozen=True, slots=True, eq=False)
class GroundPlane:
    """The ground seen from the target LiDAR.

    Args:
        normal: (3,) unit, upwards, in the target frame.
        offset_m: ``normal @ p + offset_m == 0`` on the plane, so the target LiDAR's height above ground.
        T_base_target: roll, pitch and z of the target LiDAR in an ISO 8855 base frame on the ground below it; x, y and
            yaw are zero.
        inlier_share: share of the merged cloud that lies on the plane.
    """

    normal: FloatArray
    offset_m: float
    T_base_target: RigidTransform
    inlier_share: float


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """How far the snapshots of one rig scatter in where they place a LiDAR.

    Args:
        snapshots: how many place it.
        xyz_m, rotation_deg: (3,) sample standard deviations along and about the target's axes; None below two.
    """

    snapshots: int
    xyz_m: FloatArray | None = None
    rotation_deg: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LidarPlacement:
    """Where one LiDAR ended, or why it did not.

    Args:
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), both along the target's axes.
        T_target_source_prior: the pose that the prior claims; None where it lacks the LiDAR or the target.
        sigma_from: what the covariance rests on.
        spread: over the snapshots of a joint result; None where there is only one snapshot.
    """

    lidar: str
    reason: str
    placed: bool = False
    T_target_source: RigidTransform | None = None
    fitness: float = 0.0
    rmse_m: float = float("inf")
    covariance: FloatArray | None = None
    T_target_source_prior: RigidTransform | None = None
    sigma_from: SigmaOrigin = "residuals"
    spread: Spread | None = None

    @property
    def prior_deviation(self) -> tuple[float, float] | None:
        """Distance in metres, angle in radians from the pose of the prior; None where one of the two is not known."""
        if self.T_target_source is None or self.T_target_source_prior is None:
            return None
        return self.T_target_source_prior.distance_to(self.T_target_source)

    @property
    def sigma_xyz_m(self) -> FloatArray | None:
        """(3,) standard deviation of the position along the target's axes; None where it is not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)[3:])

    @property
    def sigma_rotation_deg(self) -> FloatArray | None:
        """(3,) standard deviation of the rotation about the target's axes; None where it is not known."""
        return None if self.covariance is None else np.rad2deg(np.sqrt(np.diag(self.covariance)[:3]))


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a snapshot was not calibrated at all.

    Args:
        code: stable name, for programs: `moving_vehicle`, `too_few_lidars`, `blind_target`.
        text: the sentence of the error that `calibrate` raises.
    """

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class SnapshotDeviation:
    """How far one snapshot by itself places a LiDAR from where the joint result has it.

    Args:
        outlier: whether the snapshot was outvoted on this LiDAR.
    """

    lidar: str
    distance_m: float
    angle_deg: float
    outlier: bool = False

    @property
    def text(self) -> str:
        """How far, for people."""
        return f"{1000.0 * self.distance_m:.1f} mm, {self.angle_deg:.3f} deg"


@dataclass(frozen=True, slots=True)
class SnapshotReport:
    """What one snapshot contributed to a joint result.

    Args:
        deviations: of the LiDARs that it places, in name order.
        disputed: LiDARs on which it contradicts other snapshots and no majority settles who is right.
        refusal: why the whole snapshot was left out; empty if it was not.
    """

    name: str
    source: str
    source_sha256: str
    deviations: tuple[SnapshotDeviation, ...] = ()
    disputed: tuple[str, ...] = ()
    refusal: str = ""

    @property
    def outliers(self) -> tuple[SnapshotDeviation, ...]:
        """The LiDARs on which the other snapshots outvoted this one."""
        return tuple(deviation for deviation in self.deviations if deviation.outlier)

    @property
    def text(self) -> str:
        """What became of it, for people."""
        if self.refusal:
            return f"left out: {self.refusal}"
        parts = [
            f"OUTLIER: {each.lidar} is off by {each.text} where the other snapshots agree" for each in self.outliers
        ]
        parts += [f"contradicts other snapshots on {lidar}, and no majority settles it" for lidar in self.disputed]
        if parts:
            return "; ".join(parts)
        if not self.deviations:
            return "places no LiDAR relative to the target"
        largest = max(self.deviations, key=lambda deviation: deviation.distance_m)
        return f"agrees: {largest.lidar} is off most, by {largest.text}"


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """The outcome.

    Args:
        target: root of all poses.
        target_reason: why that LiDAR is the target.
        placements: per LiDAR in name order, the target with the identity.
        pairs: registrations of all pairs that were tried, in name order.
        decisions: the merge steps in order.
        timing_s: wall time per stage.
        refinement: what the joint adjustment did; None where it did not run.
        health: of each LiDAR that was examined, in name order.
        refusal: None unless the snapshot was not fit.
        trusted: the registrations that the poses rest on: accepted pairs, with merges that joined what none of them do.
        snapshots: what each snapshot contributed; empty where there is only one.
    """

    target: str
    target_reason: str
    placements: tuple[LidarPlacement, ...]
    pairs: tuple[PairRegistration, ...] = ()
    decisions: tuple[MergeDecision, ...] = ()
    ground: GroundPlane | None = None
    timing_s: Mapping[str, float] = field(default_factory=dict)
    refinement: Refinement | None = None
    health: tuple[SensorHealth, ...] = ()
    refusal: Refusal | None = None
    trusted: tuple[PairRegistration, ...] = ()
    snapshots: tuple[SnapshotReport, ...] = ()

    @property
    def status(self) -> Status:
        """``complete`` if every LiDAR is placed, ``failed`` if none but the target is."""
        placed = sum(placement.placed for placement in self.placements)
        if placed == len(self.placements):
            return "complete"
        return "partial" if placed > 1 else "failed"

    def __getitem__(self, lidar: str) -> LidarPlacement:
        """The placement of that LiDAR; KeyError if the rig has none of that name."""
        for placement in self.placements:
            if placement.lidar == lidar:
                return placement
        raise KeyError(lidar)
