# SPDX-License-Identifier: Apache-2.0
"""Registrations of pairs with their verdicts."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import Field

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.hypotheses import Hypothesis, IndexArray, hypothesis_label, pose_name
from multilica.results.values import Figure, Number, not_in_document
from multilica.results.visibility_score import VisibilityScore

# Poses that a slide or a repetition leads to have the same attitude.
_SAME_ATTITUDE_RAD = float(np.deg2rad(5.0))


@dataclass(frozen=True, slots=True)
class Stability:
    """Motion of the registered pose after perturbations; rotations count as arcs at 10 m."""

    sigma_m: Annotated[Number, Field(description="Standard deviation of the position in its weakest direction.")]
    sigma_rad: Annotated[Number, Field(description="Standard deviation of the attitude in its weakest direction.")]
    perturbation_m: Annotated[Figure, Field(description="Displacement of the pose along its weakest direction.")]
    perturbed_offset_m: Annotated[
        Figure, Field(description="Distance from the pose to the end of the registration after the perturbation.")
    ]
    thinned_offset_m: Annotated[
        Figure, Field(description="Distance from the pose to the end of the registration of fewer points.")
    ]


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class Registration:
    """One hypothesis after GICP, with its visibility score.

    Args:
        hypothesis: index of the pair's hypothesis that it started from; -1 if the pose came from other pairs.
        origin: of that hypothesis; "" if it came from other pairs.
        fitness, rmse_m: NaN for a pose that was scored but never registered.
        weakest_curvature: smallest eigenvalue of the GICP Hessian per inlier, rotations scaled by `LEVER_ARM_M`: near
            zero where the pose can slide without a worse fit. NaN without a Hessian.
        probes_m: (N, 3) scored points of the source, in its own frame, to which `visibility.labels` belong.
        target_probes_m: (M, 3) scored points of the target, in its own frame, as `visibility.target_labels`.
        stability: None where it was not tested.
        derivation: as `Hypothesis.derivation`.
    """

    hypothesis: int
    T_target_source: RigidTransform
    visibility: VisibilityScore
    fitness: float
    rmse_m: float
    weakest_curvature: float
    probes_m: FloatArray
    origin: str = ""
    target_probes_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    stability: Stability | None = None
    derivation: str = ""

    @property
    def label(self) -> str:
        """Name of its hypothesis in paths."""
        return hypothesis_label(self.hypothesis, self.origin)

    @property
    def name(self) -> str:
        """The origin of the pose as text."""
        return pose_name(self.hypothesis, self.origin, self.derivation)

    @property
    def evidence(self) -> float:
        """Log-odds that the pose is the true one; see `VisibilityScore.evidence`."""
        return self.visibility.evidence(float(np.linalg.norm(self.T_target_source.xyz_m)))

    @property
    def is_derived(self) -> bool:
        """True if it was turned, repeated or slid from the pose of a hypothesis of matches."""
        return bool(self.derivation) and self.hypothesis >= 0

    def lead_over(self, other: "Registration") -> float:
        """Return the log-odds that this pose is the true one and not another registered pose of the pair."""
        leads = _LEADS.setdefault(self, WeakKeyDictionary())
        if other not in leads:
            leads[other] = self.evidence - other.evidence_beside(self)
        return leads[other]

    def rough_lead_over(self, other: "Registration") -> float:
        """Return the same for a pose that is some decimetres from where it would fit best."""
        return self.evidence - other.rough_evidence_beside(self)

    def evidence_beside(self, best: "Registration") -> float:
        """Return the evidence as it compares with that of another registered pose.

        See `VisibilityScore.evidence_beside`, and `VisibilityScore.lead_along` for poses of the same attitude.
        """
        evidence = self.rough_evidence_beside(best)
        shift_m = self.T_target_source.xyz_m - best.T_target_source.xyz_m
        metres, radians = best.T_target_source.distance_to(self.T_target_source)
        if metres == 0.0 or radians > _SAME_ATTITUDE_RAD:
            return evidence
        return round(evidence - best.visibility.lead_along(self.visibility, shift_m / metres), 6) + 0.0

    def rough_evidence_beside(self, best: "Registration") -> float:
        """Return the same for a pose that is some decimetres from where it would fit best."""
        return self.visibility.evidence_beside(best.visibility, float(np.linalg.norm(self.T_target_source.xyz_m)))

    def as_hypothesis(self, best: "Registration") -> Hypothesis:
        """Return the pose as a hypothesis of the same origin, with its evidence beside the best pose of the pair."""
        pose, index, evidence = self.T_target_source, self.hypothesis, self.evidence_beside(best)
        return Hypothesis(pose, origin=self.origin, index=index, evidence=evidence, derivation=self.derivation)

    @property
    def figures(self) -> dict[str, float | None]:
        """The figures of the pose, under the names that every output gives them."""
        return {
            "evidence": self.evidence,
            "fitness": self.fitness,
            "rmse_m": self.rmse_m,
            "coverage": self.visibility.coverage,
            "violation_share": self.visibility.violation_share,
        }


# Leads of poses over others: a search ranks the same poses again for each one that it finds.
_LEADS: WeakKeyDictionary[Registration, WeakKeyDictionary[Registration, float]] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a registration was not accepted, or a sensor not trusted."""

    code: Annotated[str, Field(description="Stable name, for programs.")]
    value: Annotated[Figure, Field(description="The measured figure.")]
    limit: Annotated[Figure, Field(description="The limit that the figure exceeds or misses.")]
    text: Annotated[str, Field(description="The reason for people.")]
    # The pose that casts the doubt, if one does.
    competing: Annotated[Registration | None, *not_in_document()] = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a registration, with its reasons."""

    # Undecided: it has competitors or contradicts others. Rejected: it cannot be true.
    outcome: Annotated[
        Literal["accept", "uncertain", "undecided", "reject"],
        Field(description="`uncertain` if only its standard deviation is above the limit."),
    ]
    reasons: Annotated[tuple[Reason, ...], Field(description="Reasons against it; empty if it is accepted.")] = ()

    @property
    def accepted(self) -> bool:
        """True if the registration may be merged."""
        return self.outcome == "accept"

    @property
    def counts(self) -> bool:
        """True if it is accepted, or uncertain: then it may join LiDARs that no accepted one does."""
        return self.outcome in ("accept", "uncertain")

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of the reasons, in order."""
        return tuple(reason.code for reason in self.reasons)

    @property
    def text(self) -> str:
        """All reasons in one line; empty if accepted."""
        return "; ".join(reason.text for reason in self.reasons)


@dataclass(frozen=True, slots=True)
class GicpStep:
    """One observed moment of GICP.

    Args:
        iteration: iterations done since the start.
        inliers: source points that have a target point within `max_correspondence_distance_m`.
        fitness: their share of all source points.
        error: the engine's objective; NaN where the engine does not report it.
        translation_step_m, rotation_step_rad: movement of the iterations since the last observed moment, without leaps.
    """

    iteration: int
    max_correspondence_distance_m: float
    inliers: int
    fitness: float
    error: float
    translation_step_m: float
    rotation_step_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class BiasInformation:
    """Information of a pair about its pose and about the systematic errors of both LiDARs.

    The order of the N unknowns is rotation (rad), translation (m), then the biases of the target and of the source,
    each in range (m), elevation (rad), scale of the ranges, and range on grazed surfaces (m). Then come the rings of
    the target and of the source, each with biases in range (m), elevation and azimuth (rad) on top of those of its
    LiDAR.

    Args:
        information: (N, N) of the data alone, without a prior of the biases.
        gradient: (N,) of the negative log likelihood at the pose and the biases of this registration.
        spread: (N, N) covariance of the gradient.
        random_spread: (N, N) the part of it that random errors cause.
        biases: (N - 6,) of the target, of the source, and of the rings.
        target_rings, source_rings: (R,) numbers of the rings.
        few_spread: (N, N) the part of the spread because few surfaces tell of its size; None: nothing.
    """

    information: FloatArray
    gradient: FloatArray
    spread: FloatArray
    random_spread: FloatArray
    biases: FloatArray
    target_rings: IndexArray = field(default_factory=lambda: np.empty(0, np.int64))
    source_rings: IndexArray = field(default_factory=lambda: np.empty(0, np.int64))
    few_spread: FloatArray | None = None

    def with_spreads_changed(self, change: FloatArray) -> "BiasInformation":
        """Return the same with the spreads of the gradient times a change (N, N)."""
        return replace(
            self,
            spread=change @ self.spread @ change.T,
            random_spread=change @ self.random_spread @ change.T,
            few_spread=None if self.few_spread is None else change @ self.few_spread @ change.T,
        )

    def spread_among(self, snapshots: int) -> FloatArray:
        """Return the spread (N, N) if so many snapshots of the pair tell of its size."""
        return self.spread if self.few_spread is None else self.spread - (1.0 - 1.0 / snapshots) * self.few_spread


@dataclass(frozen=True, slots=True, eq=False)
class PairRegistration:
    """The result of registering two LiDARs, or two groups of them.

    Args:
        target, source: LiDARs, or roots of groups during merging.
        fitness: source points within `fine.fitness_distance_m` of the target cloud, as a share of all source points.
        rmse_m: root mean square distance of those points to their nearest target point.
        converged: whether GICP converged with each of its correspondence distances; None where the engine does not
            report it.
        iterations: of GICP; None where the engine does not report them.
        hessian: (6, 6) of the objective, order rotation xyz, translation xyz about the source frame; None where the
            engine does not report it.
        information: (6, 6) inverse covariance of the pose, order rotation (rad), translation (m) along the target's
            axes, the rotation about the source's origin; None where too few points match.
        bias_information: None where the biases are not estimated.
        hypothesis: index of the pair's hypothesis that this started from; -1 if the pose came from other pairs.
        steps: progress, for the recording.
        registrations: the distinct finalists, the chosen one first; empty where verification is off.
    """

    target: str
    source: str
    T_target_source: RigidTransform
    fitness: float
    rmse_m: float
    inliers: int
    converged: bool | None
    iterations: int | None
    engine: str
    hypothesis: int = 0
    hessian: FloatArray | None = None
    information: FloatArray | None = None
    bias_information: BiasInformation | None = None
    steps: tuple[GicpStep, ...] = ()
    registrations: tuple[Registration, ...] = ()
    verdict: Verdict = Verdict("accept")

    @property
    def lidars(self) -> frozenset[str]:
        """Target and source, without order."""
        return frozenset((self.target, self.source))

    @property
    def start_label(self) -> str:
        """Name in paths of the hypothesis that it started from."""
        return self.registrations[0].label if self.registrations else str(self.hypothesis)

    @property
    def start_name(self) -> str:
        """The origin of the pose as text."""
        return self.registrations[0].name if self.registrations else pose_name(self.hypothesis, "")

    @property
    def evidence(self) -> float:
        """Evidence of the chosen pose; the fitness where verification is off."""
        return self.registrations[0].evidence if self.registrations else self.fitness

    @property
    def coverage(self) -> float:
        """Share of agreeing points among those in the other LiDAR's view; NaN without verification."""
        return self.registrations[0].visibility.coverage if self.registrations else float("nan")

    @property
    def figures(self) -> dict[str, float | None]:
        """The figures of the pair, under the names that every output gives them.

        None or NaN where one is not known. `sigma_m` and `sigma_deg` are those of the weakest directions.
        """
        sigma_m, sigma_rad = weakest_sigmas(self.information)
        unknown = {"evidence": None, "violation_share": None}
        return {
            **(self.registrations[0].figures if self.registrations else unknown),
            "coverage": self.coverage,
            "fitness": self.fitness,
            "rmse_m": self.rmse_m,
            "sigma_m": sigma_m,
            "sigma_deg": None if sigma_rad is None else float(np.rad2deg(sigma_rad)),
        }

    @property
    def competing(self) -> Registration | None:
        """The pose that makes the chosen one doubtful; None if no pose does."""
        return next((reason.competing for reason in self.verdict.reasons if reason.competing is not None), None)


def connected(root: str, pairs: Iterable[PairRegistration]) -> set[str]:
    """Return the LiDARs that a chain of pairs connects to the root, which is one of them."""
    pairs = list(pairs)
    reached = {root}
    for _ in pairs:
        for pair in pairs:
            if pair.lidars & reached:
                reached |= pair.lidars
    return reached


def weakest_sigmas(information: FloatArray | None) -> tuple[float | None, float | None]:
    """Return `weakest_deviations` of a pose with that (6, 6) information; None where it has none."""
    if information is None:
        return None, None
    return weakest_deviations(np.asarray(np.linalg.pinv(information, hermitian=True)))


def weakest_deviations(covariance: FloatArray) -> tuple[float, float]:
    """Return the largest standard deviations of position (m) and rotation (rad) of a (6, 6) covariance.

    The order is rotation, then translation.
    """
    variances = np.linalg.eigvalsh(covariance[3:, 3:])[-1], np.linalg.eigvalsh(covariance[:3, :3])[-1]
    sigma_m, sigma_rad = (float(np.sqrt(max(variance, 0.0))) for variance in variances)
    return sigma_m, sigma_rad
