# SPDX-License-Identifier: Apache-2.0
"""Pairs of LiDARs in the result document, from registration to refinement."""

import numpy as np
from pydantic import Field

from multilica.geometry import RigidTransform
from multilica.results.registrations import Stability, Verdict
from multilica.results.values import Entry, Matrix4, Matrix6, Number, PairNames, PoseEntry


class RegistrationEntry(Entry):
    """One hypothesis after GICP, with its visibility score."""

    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    origin: str = Field(description="Solver of that hypothesis, or `prior`; empty if the pose came from other pairs.")
    derivation: str = Field(
        "",
        description="Relation of the pose to its hypothesis, or the LiDARs that imply it; else empty.",
    )
    T_target_source: Matrix4 = Field(description="Rows of the homogeneous matrix, lengths.")
    agree: int = Field(description="Points on a surface that the other LiDAR measured.")
    violate: int = Field(description="Points in space that beams of the other LiDAR passed through.")
    occluded: int = Field(description="Points behind a measured surface.")
    unseen: int = Field(description="Points outside the field of view of the other LiDAR.")
    evidence: Number = Field(description="Log-odds that the pose is the true one; the rank.")
    fitness: Number = Field(description="Share of the points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    weakest_curvature: Number = Field(
        description="Smallest eigenvalue of the GICP Hessian per inlier; rotation at 10 m."
    )
    min_information_eigenvalue: Number = Field(description="Number of points that constrain the weakest direction.")
    stability: Stability | None = Field(description="Result of the stability test; null if it was not run.")


class PairEntry(PoseEntry, PairNames):
    """A registered pair of LiDARs."""

    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    inliers: int = Field(description="Number of those points.")
    converged: bool | None = Field(description="True if GICP converged; null if the engine does not report it.")
    iterations: int | None = Field(description="Number of GICP iterations; null where the engine does not report it.")
    engine: str = Field(description="GICP implementation.")
    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    hessian: Matrix6 | None = Field(description="GICP Hessian, order rotation, translation, about the source frame.")
    verdict: Verdict = Field(description="The decision on this pair.")
    registrations: tuple[RegistrationEntry, ...] = Field(description="Chosen first; empty without verification.")

    @property
    def pose(self) -> RigidTransform:
        """``T_target_source`` of the pair."""
        return RigidTransform(self.target, self.source, np.asarray(self.T_target_source))

    @property
    def evidence(self) -> float:
        """Evidence of the chosen registration; the fitness without verification."""
        return (self.registrations[0].evidence if self.registrations else self.fitness) or 0.0
