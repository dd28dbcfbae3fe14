# SPDX-License-Identifier: Apache-2.0
"""Scores of a pose by what the beams prove free or occupied."""

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf, log, log1p

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray

PRIOR_LOG_ODDS = -8.3
"""Log-odds of a pose with nothing to be said for it or against it. This and the weights below are those of a logistic
regression over registered poses of simulated rigs; see docs/decisions/0006-one-model-accepts.md."""

DISTINCTIVE_WEIGHT = 2.7
"""Weight of the logarithm of the number of distinctive points."""

VIOLATION_WEIGHT = 4.9
"""Weight of the logarithm of the number of points in proven-empty space: a correct pose causes hardly any."""

HIDDEN_WEIGHT = 1.5
"""Weight of the logarithm of the share of the structure in view that is not hidden from one of the two."""

DISTANCE_WEIGHT = 2.1
"""Weight of the logarithm of the distance between the sensors: chance agreements are anywhere, vehicles are short."""

STOP_DISTANCE_M = 6.0
"""Between stops, each distance counts as this one. A vehicle drives on by any distance, so that a near pose is no
likelier than a far one, which may be a house or a bay away; see docs/decisions/0006-one-model-accepts.md."""

STRAY_SHARE = 0.003
"""Share of points in empty space, of all that agree, that occurs by chance: foliage, glass, moving things."""

STRAY_STRUCTURE_SHARE = 0.05
"""The same share of structure alone, beyond `MOVED_POINTS`: three times the most of 417 right poses. The ground, which
agrees at most poses, does not excuse walls and objects that do not."""

MOVED_POINTS = 4
"""Points in empty space that one person causes who moved between the scans: 1.7 m by 0.5 m in patches of 0.5 m. So few
never decide between two poses."""

FACING_WEIGHT = 2.8
"""Weight of the logarithm of the number of points that face a shift and agree at one of two poses only."""

FACING_POINTS = 8
"""Prior count of these points: the rear of one car, in patches of 0.5 m, which may have moved between the scans."""

FEW_POINTS = 10
"""Prior count of agreeing structure points, so that a few hidden points in an open field change little."""

# Evidence beside another pose is rounded twice.
_ROUNDING = 2e-6


class BeamLabel(IntEnum):
    """Evidence of a sensor's beams on a point that another sensor measured."""

    UNSEEN = 0
    """Outside the field of view, or between beams that are too far apart."""
    AGREE = 1
    """On a surface that the beams measured."""
    VIOLATE = 2
    """In space that the beams passed through."""
    OCCLUDED = 3
    """Behind a measured surface: says nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibilityScore:
    """Labels and counts that the beams of both sides give to each other's points.

    Args:
        agree, violate, occluded, unseen: number of points with that `BeamLabel`, of both sides.
        information: (6, 6) sum of J J^T over the agreeing points, J = (turn, shift) by which a small motion lifts a
            point off its surface; order rotation, translation in the target's axes about the source's origin,
            rotations scaled by `LEVER_ARM_M` of geometry.
        labels: (N,) `BeamLabel` of each probe of the source, by the target's beams.
        structure_agree, structure_violate, structure_occluded: the same counts over structure alone: closed surfaces
            off the commonest orientation, so walls and vehicles, not the ground.
        target_labels: (M,) `BeamLabel` of each probe of the target, by the source's beams.
        violating: (K,) which of all labelled points are in empty space, of all members of both sides, in the same order
            for each pose; empty where unknown.
        agreeing: (A,) numbers of those labelled points that agree and whose neighbours span a surface.
        agreeing_normals: (A, 3) their unit normals along the target's axes.
        between_stops: whether the vehicle has driven on between the measurements of both sides.
    """

    agree: int
    violate: int
    occluded: int
    unseen: int
    information: FloatArray
    labels: npt.NDArray[np.uint8]
    structure_agree: int = 0
    structure_violate: int = 0
    structure_occluded: int = 0
    target_labels: npt.NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    violating: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    agreeing: npt.NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    agreeing_normals: npt.NDArray[np.float16] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.float16))
    between_stops: bool = False

    @property
    def weakest_direction(self) -> FloatArray:
        """(6,) unit vector of the least constrained motion; order as `information`."""
        return np.asarray(np.linalg.eigh(self.information)[1][:, 0])

    @property
    def slide_direction(self) -> FloatArray:
        """(3,) unit vector of the least constrained shift, the rotation free to follow."""
        return np.asarray(np.linalg.eigh(self._shift_information)[1][:, 0])

    @property
    def slide_share(self) -> float:
        """Information about the least constrained shift, as a share of that about the next one."""
        least, following, _ = np.linalg.eigvalsh(self._shift_information)
        return float(least / max(following, np.finfo(float).tiny))

    @property
    def _shift_information(self) -> FloatArray:
        """(3, 3) of a shift, the rotation free to follow."""
        turn, cross, shift = self.information[:3, :3], self.information[:3, 3:], self.information[3:, 3:]
        return np.asarray(shift - cross.T @ np.linalg.pinv(turn) @ cross)

    @property
    def distinctive(self) -> float:
        """Number of agreeing points off the commonest orientation: one plane, the ground, fits nearly everywhere."""
        return float(self.agree - np.linalg.eigvalsh(self.information[3:, 3:])[-1])

    @property
    def contradiction(self) -> float:
        """Log-odds that the points in empty space take from the pose, at least 0."""
        too_many = self.violate - STRAY_SHARE * self.agree
        if not self.between_stops:
            of_structure = self.structure_violate - STRAY_STRUCTURE_SHARE * self.structure_agree - MOVED_POINTS
            too_many = max(too_many, of_structure)
        return VIOLATION_WEIGHT * log1p(max(0.0, too_many))

    def contradiction_against(self, other: "VisibilityScore") -> float:
        """Return the log-odds that points in empty space take from this pose and not from another of the same pair.

        Points that are in empty space at both poses say nothing about the two. The others are not excused by the many
        points that agree, because most of these agree at both poses.
        """
        if len(self.violating) != len(other.violating) or len(self.violating) == 0:
            return self.contradiction - other.contradiction
        own = np.count_nonzero(self.violating & ~other.violating) + MOVED_POINTS
        return VIOLATION_WEIGHT * log(own / (np.count_nonzero(other.violating & ~self.violating) + MOVED_POINTS))

    def lead_along(self, other: "VisibilityScore", direction: FloatArray) -> float:
        """Return the log-odds that points facing a shift add to this pose against another of the same pair.

        Walls and rails along a road agree wherever the pose slides to. Posts, signs and ends of walls face the road.
        They agree at the true pose, and at others only where they repeat.

        Args:
            direction: (3,) unit vector of the shift between both poses, along the target's axes.
        """
        own, others = _facing_only_at(self, other, direction), _facing_only_at(other, self, direction)
        return FACING_WEIGHT * log((own + FACING_POINTS) / (others + FACING_POINTS))

    def evidence(self, distance_m: float) -> float:
        """Return the log-odds that the pose is the true one; poses rank by it.

        Rounded, because poses that are the same or symmetric tie, and the last bits differ between CPUs.

        Args:
            distance_m: between the two sensors.
        """
        for_it = DISTINCTIVE_WEIGHT * log1p(max(0.0, self.distinctive))
        against = self.against_distance(distance_m) - HIDDEN_WEIGHT * log(self.shared_share) + self.contradiction
        return round(PRIOR_LOG_ODDS + for_it - against, 6) + 0.0

    def against_distance(self, distance_m: float) -> float:
        """Return the log-odds that the distance between the sensors takes from the pose, at least 0."""
        return DISTANCE_WEIGHT * log1p(STOP_DISTANCE_M if self.between_stops else distance_m)

    def evidence_beside(self, best: "VisibilityScore", distance_m: float) -> float:
        """Return the evidence, with points in empty space counted against another pose: see `contradiction_against`."""
        excess = self.contradiction_against(best) - (self.contradiction - best.contradiction)
        return round(self.evidence(distance_m) - excess, 6) + 0.0

    def most_beside(self, best: "VisibilityScore", distance_m: float, further: int) -> float:
        """Return what `evidence_beside` is at most after this many further points are labelled, which follow these."""
        known = len(self.violating)
        if len(best.violating) != known + further:
            return inf
        shared = np.count_nonzero(self.violating & best.violating[:known])
        own = np.count_nonzero(self.violating) - shared + MOVED_POINTS
        of_best = np.count_nonzero(best.violating) - shared + MOVED_POINTS
        against = self.against_distance(distance_m) + best.contradiction + VIOLATION_WEIGHT * log(own / of_best)
        return PRIOR_LOG_ODDS + DISTINCTIVE_WEIGHT * log1p(self.agree + further) - against + _ROUNDING

    @property
    def min_information_eigenvalue(self) -> float:
        """Smallest eigenvalue of the information: points that constrain the weakest direction."""
        return float(np.linalg.eigvalsh(self.information)[0])

    @property
    def shared_share(self) -> float:
        """Share of the structure in view that both sides saw; the rest is hidden from one of them."""
        agree = self.structure_agree + FEW_POINTS
        return agree / (agree + self.structure_occluded)

    @property
    def coverage(self) -> float:
        """Share of agreeing points among those in the other LiDAR's view; 0 if none are."""
        return self.agree / max(1, self.agree + self.violate + self.occluded)

    @property
    def violation_share(self) -> float:
        """Violations as a share of the points that agree or violate."""
        return self.violate / max(1, self.agree + self.violate)


def _facing_only_at(score: VisibilityScore, other: VisibilityScore, direction: FloatArray) -> float:
    """Sum the squared cosines between a direction and the normals that agree at one pose and not at the other."""
    points = len(score.violating)
    if points == 0 or points != len(other.violating):
        return 0.0
    agrees_there = np.zeros(points, dtype=bool)
    agrees_there[other.agreeing] = True
    cosines = score.agreeing_normals.astype(np.float32) @ direction.astype(np.float32)
    return float(np.square(cosines) @ (~agrees_there[score.agreeing]).astype(np.float32))
