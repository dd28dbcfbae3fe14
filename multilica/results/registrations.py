# SPDX-License-Identifier: Apache-2.0
"""A pair after GICP, with the verdict on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.hypotheses import hypothesis_label
from multilica.results.reason import Reason
from multilica.testimony import Testimony

__all__ = ["Assessment", "FineStep", "Hold", "PairRegistration", "Verdict"]


@dataclass(frozen=True, slots=True)
class Hold:
    """How firmly the points of both clouds hold a registered pose. Turns count as arcs 10 m away.

    Args:
        sigma_m, sigma_rad: standard deviations of position and attitude in their weakest directions; None where
            too few points match.
        push_m: how far the pose was pushed along its weakest direction, either way.
        pushed_off_m: how far from the pose the registration ends when it starts from there.
        thinned_off_m: how far from the pose the registration of fewer points ends.
    """

    sigma_m: float | None
    sigma_rad: float | None
    push_m: float
    pushed_off_m: float
    thinned_off_m: float


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
        converged: whether GICP did with each of its correspondence distances.
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
