# SPDX-License-Identifier: Apache-2.0
"""Scores of a pose by what the beams prove free or occupied."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray

__all__ = ["BeamLabel", "VisibilityScore"]

VIOLATION_WEIGHT = 30.0
"""A point in proven-empty space outweighs this many agreeing points: a correct pose causes hardly any."""

STRUCTURE_VIOLATION_WEIGHT = 60.0
"""The same for points off the commonest plane, of which a wrong pose on flat ground has few at all."""

STRAY_SHARE = 0.003
"""Share of points in empty space, of all that agree, that occurs by chance: foliage, glass, moving things."""

STRAY_STRUCTURE_POINTS, STRAY_STRUCTURE_SHARE = 2, 0.001
"""The same for points off the commonest plane, of which there are fewer: a count, and a share of all that agree."""

FEW_POINTS = 10
"""Prior count of agreeing structure points, so that a few hidden points in an open field change little."""


class BeamLabel(IntEnum):
    """What a sensor's beams say of a point that another sensor measured."""

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
        seen_through_m: distance between the sensors if beams of one pass through the place of the other and all around
            it, so that nothing can carry a sensor there; else 0.
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
    seen_through_m: float = 0.0

    @property
    def weakest_direction(self) -> FloatArray:
        """(6,) unit vector of the least constrained motion; order as `information`."""
        return np.asarray(np.linalg.eigh(self.information)[1][:, 0])

    @property
    def commonest_normal(self) -> FloatArray:
        """(3,) unit normal that most agreeing points share, usually that of the ground."""
        return np.asarray(np.linalg.eigh(self.information[3:, 3:])[1][:, -1])

    @property
    def slide_direction(self) -> FloatArray:
        """(3,) unit vector of the least constrained shift, the rotation free to follow."""
        turn, cross, shift = self.information[:3, :3], self.information[:3, 3:], self.information[3:, 3:]
        return np.asarray(np.linalg.eigh(shift - cross.T @ np.linalg.pinv(turn) @ cross)[1][:, 0])

    @property
    def distinctive(self) -> float:
        """Number of agreeing points off the commonest orientation: one plane, the ground, fits nearly everywhere."""
        return float(self.agree - np.linalg.eigvalsh(self.information[3:, 3:])[-1])

    @property
    def evidence(self) -> float:
        """Distinctive points, weighted by the share that is not hidden, less weighted violations; poses rank by it.

        Rounded, because poses that are the same or symmetric tie, and the last bits differ between CPUs.
        """
        against = max(0.0, self.violate - STRAY_SHARE * self.agree)
        weighed = self.distinctive * self.shared_share - VIOLATION_WEIGHT * against
        return round(min(weighed, 0.0) if self.seen_through_m else weighed, 6) + 0.0

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
    def explained_share(self) -> float:
        """Share of the structure in view that lies on measured surfaces, neither hidden nor in empty space.

        Sensors of one vehicle are near each other, so little is hidden from one of them alone.
        """
        violate = max(0.0, self.structure_violate - STRAY_STRUCTURE_POINTS - STRAY_STRUCTURE_SHARE * self.agree)
        against = self.structure_occluded + STRUCTURE_VIOLATION_WEIGHT * violate
        agree = self.structure_agree + FEW_POINTS
        return agree / (agree + against)

    @property
    def violation_share(self) -> float:
        """Violations as a share of the points that agree or violate."""
        return self.violate / max(1, self.agree + self.violate)
